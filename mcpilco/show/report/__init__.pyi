from .crossing_page import write_crossing_report
from .gap_page import write_gap_report
from .gap_tables import effects_table, errors_table, events_table, steps_table
from .page import write_report

__all__ = [
    "effects_table",
    "errors_table",
    "events_table",
    "steps_table",
    "write_crossing_report",
    "write_gap_report",
    "write_report",
]
