"""Recordings of real robots: a tracker's file becomes `Trajectories`."""

from pinav.recordings.labels import groups as groups
from pinav.recordings.labels import image_positions as image_positions
from pinav.recordings.labels import labels as labels
from pinav.recordings.reading import FORMATS as FORMATS
from pinav.recordings.reading import read_recording as read_recording
from pinav.recordings.rows import COMMAND_UNITS as COMMAND_UNITS
from pinav.recordings.rows import Reading as Reading
