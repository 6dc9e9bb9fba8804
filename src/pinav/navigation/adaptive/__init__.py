"""Learns the force while it steers: belief, plan, control and a last safety filter."""
