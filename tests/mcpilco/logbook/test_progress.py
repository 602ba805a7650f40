from __future__ import annotations

from xml.etree import ElementTree

from mcpilco.logbook import Results
from tests.mcpilco.fakes import make_result


def test_a_notebook_shows_a_row_for_each_trial() -> None:
    results = Results([make_result(1), make_result(2, told=False)])
    table = ElementTree.fromstring(results._repr_html_())
    titles, first, second = ([cell.text for cell in line] for line in table.iter("tr"))
    assert first[titles.index("time up [s]")] == "0.30"
    assert [row[titles.index("success")] for row in (first, second)] == ["yes", "-"]
    assert second[titles.index("predicted cost")] == "1.67 ± 0.50"
