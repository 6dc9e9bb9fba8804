"""Figures of results: functions that take results and return axes or figures.

A panel is drawn on `ax`, on a new figure unless that is given. `units` are the units of
the channels; one that is not listed is dimensionless.
"""

from pinav.figures.analysis import constants_figure as constants_figure
from pinav.figures.analysis import evidence_bars as evidence_bars
from pinav.figures.analysis import formula_figure as formula_figure
from pinav.figures.analysis import helmholtz_figure as helmholtz_figure
from pinav.figures.analysis import influence_figure as influence_figure
from pinav.figures.analysis import law_agreement as law_agreement
from pinav.figures.analysis import law_figure as law_figure
from pinav.figures.analysis import law_ranking as law_ranking
from pinav.figures.analysis import lyapunov_figure as lyapunov_figure
from pinav.figures.analysis import potential_figure as potential_figure
from pinav.figures.analysis import sobol_figure as sobol_figure
from pinav.figures.errors import evaluation_errors_figure as evaluation_errors_figure
from pinav.figures.errors import residuals_figure as residuals_figure
from pinav.figures.images import FigureFiles as FigureFiles
from pinav.figures.images import Picture as Picture
from pinav.figures.images import save_figure as save_figure
from pinav.figures.maps import force_comparison as force_comparison
from pinav.figures.maps import map_panel as map_panel
from pinav.figures.recordings import observed_paths as observed_paths
from pinav.figures.recordings import overlay_figure as overlay_figure
from pinav.figures.recordings import recording_figure as recording_figure
from pinav.figures.style import band as band
from pinav.figures.trajectories import acceleration_figure as acceleration_figure
from pinav.figures.trajectories import decomposition as decomposition
from pinav.figures.trajectories import figure1 as figure1
from pinav.figures.trajectories import loss_curve as loss_curve
from pinav.figures.trajectories import trajectory as trajectory
from pinav.figures.trajectories import velocity as velocity
