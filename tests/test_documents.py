"""Generated documents are up to date, and every clause id and file that the tree cites exists."""

import re
import subprocess

import pytest
import yaml

from configs.strict import load, parse
from runtime.documents import results, safety, scenarios
from simulation.scenario import Scenario
from tests.recordings import ROOT

CLAUSE = re.compile(r"\b(?:BD|T14)-\d+(?:\.\d+)*[a-z]?\b")
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")


def tracked() -> list[str]:
    """Text files of the tree, as git lists them; without git all of these suffixes."""
    found = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    names = found or [str(p.relative_to(ROOT)) for p in ROOT.rglob("*") if ".venv" not in p.parts]
    return [name for name in names if name.endswith((".py", ".yaml", ".md")) and (ROOT / name).is_file()]


def clauses_with_a_row() -> set[str]:
    rows = [line.split("|")[1] for line in (ROOT / "docs/requirements.md").read_text().splitlines() if line[:1] == "|"]
    return set(CLAUSE.findall("\n".join(rows)))


def test_results_document_is_current() -> None:
    recorded = load(results.Results, results.SOURCE)
    assert results.TARGET.read_text() == results.document(recorded), "run `make docs`"
    readme = results.README.read_text()
    assert readme == results.readme(readme, recorded), "run `make docs`"
    assert sum(result.headline for result in recorded.results) == 8


def test_a_stale_result_is_found() -> None:
    recorded = load(results.Results, results.SOURCE)
    changed = recorded.model_copy(update={"results": recorded.results[1:]})
    assert results.TARGET.read_text() != results.document(changed)


def test_safety_document_is_current() -> None:
    marked = safety.marked_tests(safety.TESTS)
    assert safety.TARGET.read_text() == safety.document(marked), "run `make docs`"
    assert safety.TARGET.read_text() != safety.document(marked[1:])


def test_scenarios_document_is_current() -> None:
    """Keys, values and defaults of every section, the catalogue, and an example that loads."""
    text = scenarios.TARGET.read_text()
    assert text == scenarios.document(), "run `make docs`"
    example = yaml.safe_load(text.split("```yaml")[1].split("```")[0])
    assert [one.name for one in parse(Scenario, example, "docs/scenarios.md").objects] == ["car", "child"]


def test_clauses_of_safety_have_tests() -> None:
    marked = {test.clause for test in safety.marked_tests(safety.TESTS)}
    assert set(safety.clauses_of_section_4()) <= marked


@pytest.mark.parametrize("name", tracked())
def test_cited_clauses_are_in_requirements(name: str) -> None:
    cited = set(CLAUSE.findall((ROOT / name).read_text()))
    assert cited <= clauses_with_a_row(), sorted(cited - clauses_with_a_row())


@pytest.mark.parametrize("name", [name for name in tracked() if name.endswith(".md")])
def test_linked_files_exist(name: str) -> None:
    file = ROOT / name
    for target in LINK.findall(file.read_text()):
        assert (file.parent / target).exists(), target


def test_files_cited_in_architecture_exist() -> None:
    cited = re.findall(r"`([a-z_]+(?:/[a-z_0-9]+)+\.(?:py|yaml|md))`", (ROOT / "docs/architecture.md").read_text())
    assert len(cited) > 40
    assert not [path for path in cited if not (ROOT / path).exists()]
