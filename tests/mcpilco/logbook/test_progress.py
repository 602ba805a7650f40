from __future__ import annotations

from io import StringIO
from xml.etree import ElementTree

from rich.console import Console

from mcpilco.logbook import Progress, Results
from tests.mcpilco.fakes import make_result


def test_a_notebook_shows_a_row_for_each_trial() -> None:
    results = Results([make_result(1), make_result(2, told=False)])
    table = ElementTree.fromstring(results._repr_html_())
    titles, first, second = ([cell.text for cell in line] for line in table.iter("tr"))
    assert first[titles.index("time up [s]")] == "0.30"
    assert [row[titles.index("success")] for row in (first, second)] == ["yes", "-"]
    assert second[titles.index("predicted cost")] == "1.67 ± 0.50"


def test_a_line_says_that_many_samples_are_known_through_few() -> None:
    console = Console(file=StringIO(), width=40)
    progress = Progress(console)
    progress.on_model_fitted({"model/samples": 150.0})
    numbers = {"model/samples": 3000.0, "model/fitted_samples": 600.0}
    progress.on_model_fitted(numbers | {"model/inducing_points": 300.0})
    progress.on_model_fitted(numbers | {"model/posterior_samples": 250.0})
    line, subset = console.file.getvalue().splitlines()
    assert "predictions from 250 of them" in subset
    assert "3000 samples" in line
    assert "from 600 of them" in line
    assert "300 inducing points" in line
