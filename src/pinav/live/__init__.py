"""Live sessions: a rig's frames in, estimates and commands out, as lines of JSON."""
