"""Figures of results: functions that take results and return axes or figures."""

from pinav.figures.analysis import constants_figure as constants_figure
from pinav.figures.analysis import helmholtz_figure as helmholtz_figure
from pinav.figures.analysis import influence_figure as influence_figure
from pinav.figures.analysis import lyapunov_figure as lyapunov_figure
from pinav.figures.analysis import potential_map as potential_map
from pinav.figures.analysis import sobol_figure as sobol_figure
from pinav.figures.analysis import trust_map as trust_map
from pinav.figures.evidence import evidence_bars as evidence_bars
from pinav.figures.files import FigureFiles as FigureFiles
from pinav.figures.files import save_figure as save_figure
from pinav.figures.force_maps import force_comparison as force_comparison
from pinav.figures.force_maps import force_error_map as force_error_map
from pinav.figures.force_maps import force_map as force_map
from pinav.figures.force_maps import force_sd_map as force_sd_map
from pinav.figures.laws import law_agreement as law_agreement
from pinav.figures.laws import law_figure as law_figure
from pinav.figures.laws import law_ranking as law_ranking
from pinav.figures.observations import observed_paths as observed_paths
from pinav.figures.recordings import overlay as overlay
from pinav.figures.recordings import recording_figure as recording_figure
from pinav.figures.trajectories import acceleration_figure as acceleration_figure
from pinav.figures.trajectories import decomposition as decomposition
from pinav.figures.trajectories import figure1 as figure1
from pinav.figures.trajectories import loss_curve as loss_curve
from pinav.figures.trajectories import trajectory as trajectory
from pinav.figures.trajectories import velocity as velocity
