from .crossing_page import write_crossing_report
from .gap_page import write_gap_report
from .page import write_report

__all__ = [
    "write_crossing_report",
    "write_gap_report",
    "write_report",
]
