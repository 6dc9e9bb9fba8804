"""Recordings of real robots: a tracker's file becomes `Trajectories`."""

from pinav.reading import Reading as Reading
from pinav.recordings.reading import FORMATS as FORMATS
from pinav.recordings.reading import read_recording as read_recording
from pinav.recordings.rows import COMMAND_UNITS as COMMAND_UNITS
from pinav.recordings.segments import groups as groups
from pinav.recordings.segments import image_positions as image_positions
from pinav.recordings.segments import labels as labels
