"""One self-contained HTML page of sections, tables and figures."""

from pinav.report.page import NO_UNIT as NO_UNIT
from pinav.report.page import AbstractBlock as AbstractBlock
from pinav.report.page import Cell as Cell
from pinav.report.page import Code as Code
from pinav.report.page import Image as Image
from pinav.report.page import Link as Link
from pinav.report.page import Paragraph as Paragraph
from pinav.report.page import Section as Section
from pinav.report.page import Table as Table
from pinav.report.page import as_text as as_text
from pinav.report.page import capitalise as capitalise
from pinav.report.page import heading as heading
from pinav.report.page import measured as measured
from pinav.report.page import number as number
from pinav.report.page import percent as percent
from pinav.report.page import quantity as quantity
from pinav.report.page import render as render
from pinav.report.page import sections_text as sections_text
