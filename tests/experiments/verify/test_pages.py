from pathlib import Path

from experiments.verify.verify import page_findings


def test_a_page_that_quotes_what_the_results_do_not_say_is_a_fault(tmp_path: Path) -> None:
    results = tmp_path / "results"
    results.mkdir()
    assert not page_findings(results)  # no page quotes it
    (tmp_path / "README.md").write_text("It errs by <!--n:paper.size-->30 of 30 cells<!--/n-->.\n")
    (finding,) = page_findings(results)
    assert "README.md" in finding.faults[0]
    assert not page_findings(tmp_path)  # results of another place
