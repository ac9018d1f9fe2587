"""A run on disk: metrics.json, log.npz and report.html, one self-contained page; and pages like it."""

from wbmpc.plots.figures import template as template
from wbmpc.report.document import document as document
from wbmpc.report.document import named as named
from wbmpc.report.document import table as table
from wbmpc.report.files import RECORDING as RECORDING
from wbmpc.report.files import RUN_FILES as RUN_FILES
from wbmpc.report.files import about_run as about_run
from wbmpc.report.files import outcome as outcome
from wbmpc.report.files import to_json as to_json
from wbmpc.report.files import write_run as write_run
from wbmpc.report.provenance import commit as commit
from wbmpc.report.provenance import versions as versions
from wbmpc.report.run_page import exact as exact
from wbmpc.report.run_page import goal_notes as goal_notes
from wbmpc.report.run_page import goal_text as goal_text
from wbmpc.report.run_page import metric_cells as metric_cells
from wbmpc.report.run_page import page as page
from wbmpc.report.run_page import plots_page as plots_page
