"""Recordings of real robots: a tracker's file becomes `Trajectories`."""

from pinav.reading import Reading as Reading
from pinav.recordings.assembly import groups as groups
from pinav.recordings.assembly import image_positions as image_positions
from pinav.recordings.assembly import labels as labels
from pinav.recordings.reading import read_recording as read_recording
from pinav.recordings.rows import COMMAND_UNITS as COMMAND_UNITS
