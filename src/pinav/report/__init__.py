"""Figures of results, and one self-contained HTML page that holds them."""

from pinav.report.evidence import evidence_bars as evidence_bars
from pinav.report.figures import acceleration_figure as acceleration_figure
from pinav.report.figures import decomposition as decomposition
from pinav.report.figures import figure1 as figure1
from pinav.report.figures import loss_curve as loss_curve
from pinav.report.figures import trajectory as trajectory
from pinav.report.figures import velocity as velocity
from pinav.report.files import FigureFiles as FigureFiles
from pinav.report.files import save_figure as save_figure
from pinav.report.maps import force_comparison as force_comparison
from pinav.report.maps import force_error_map as force_error_map
from pinav.report.maps import force_map as force_map
from pinav.report.maps import force_sd_map as force_sd_map
from pinav.report.observations import observed_paths as observed_paths
from pinav.report.page import Code as Code
from pinav.report.page import Image as Image
from pinav.report.page import Paragraph as Paragraph
from pinav.report.page import Section as Section
from pinav.report.page import Table as Table
from pinav.report.page import number as number
from pinav.report.page import render as render
