"""The page and the summary of `orchestrator reproduce`, made for two figures."""

from __future__ import annotations

import base64
import json
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from orchestrator.cli.main import main
from orchestrator.docking.reproduction.page import headline, number, page, page_of_folder
from orchestrator.docking.reproduction.reproduce import Reproduction


class Reader(HTMLParser):
    """Rows by key as lists of cells, ids, links, images, and tags that were left open."""

    VOID = ("meta", "img", "br")

    def __init__(self) -> None:
        super().__init__()
        self.rows: dict[str, list[str]] = {}
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images: list[str] = []
        self.open: list[str] = []
        self.text: list[str] = []
        self._cells: list[str] | None = None

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        if tag not in self.VOID:
            self.open.append(tag)
        if "id" in given:
            self.ids.append(given["id"])
        self.links += [given[name] for name in ("href", "src", "srcset", "data") if name in given]
        if tag == "img":
            self.images.append(given["src"])
            assert given["alt"]
        if "data-key" in given:
            self._cells = self.rows[given["data-key"]] = []
        elif tag == "td" and self._cells is not None:
            self._cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        if tag == "tr":
            self._cells = None

    def handle_data(self, data):
        self.text.append(data)
        if self._cells:
            self._cells[-1] += data


def read(text: str) -> Reader:
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert not reader.open
    return reader


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduction")
    assert main(["reproduce", "--only", "fig7,fig6", "--out", str(out), "--quiet"]) == 0
    return out


@pytest.fixture(scope="module")
def summary(folder):
    return json.loads((folder / "reproduction.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def reader(folder):
    return read((folder / "reproduction.html").read_text(encoding="utf-8"))


def test_the_page_shows_the_numbers_of_the_summary(summary, reader):
    reported = [one for entry in summary["experiments"] for one in entry["quantities"]]
    assert list(reader.rows) == [one["key"] for one in reported]
    for one in reported:
        cells = reader.rows[one["key"]]
        assert cells[0] == f"Fig. {one['figure'].removeprefix('fig')}"
        assert cells[2] == one["paper"]
        assert cells[3] == number(one["ours"]) and float(cells[3]) == pytest.approx(one["ours"], rel=1e-4)
        assert cells[5].startswith("agrees") is (one["agrees"] is True)
        assert float(cells[6]) == pytest.approx(one["halving_change"], rel=0.05)
    assert headline(summary) in "".join(reader.text)


def test_the_page_tells_how_to_make_each_run(summary, reader):
    text = "".join(reader.text)
    (entry,) = summary["experiments"]
    assert text.count("orchestrator run docking-1d ") == len(entry["runs"]) == 2
    assert "--set 'run.stop_time=7 s'" in text


def test_the_page_holds_every_figure_and_needs_no_other_file(folder, summary, reader):
    assert summary["figures"] == ["fig6", "fig7"]
    assert [name for name in reader.ids if name.startswith("fig")] == summary["figures"]
    assert len(reader.images) == 2
    for source in reader.images:
        head, _, data = source.partition(",")
        assert head == "data:image/png;base64"
        assert base64.b64decode(data).startswith(b"\x89PNG")
    assert all(link.startswith(("#", "data:")) for link in reader.links)
    assert {path.name for path in (folder / "figures").iterdir()} == {"fig6.png", "fig7.png"}


def test_the_page_can_be_made_again_from_the_folder(folder, summary):
    again = read(page_of_folder(folder, summary))
    assert list(again.rows) == [one["key"] for entry in summary["experiments"] for one in entry["quantities"]]
    assert len(again.images) == 2 and headline(summary) in "".join(again.text)


def test_the_summary_counts_its_verdicts(summary):
    reported = [one for entry in summary["experiments"] for one in entry["quantities"]]
    assert summary["numbers"] == len(reported) == 8
    assert summary["source"] == {"agree": 8, "differ": 0} and summary["theory"] == {"agree": 0, "differ": 0}
    assert summary["runs"] == 4
    (entry,) = summary["experiments"]
    assert entry["runs"]["active"]["system"] == "docking-1d"
    by_key = {one["key"]: one for one in reported}
    assert 0.0 < abs(by_key["velocity_deviation"]["halving_change"]) < 0.01


def test_the_page_tells_failures_and_escapes_text(summary):
    (entry,) = summary["experiments"]
    failed = {**entry, "quantities": [], "figures": {}, "errors": ["active: <controller> gave up & ended"]}
    made = replace(Reproduction(summary, {}), summary={**summary, "experiments": [failed]})
    assert made.failed == ["active: <controller> gave up & ended"]
    reader = read(page(made))
    assert not reader.rows and not reader.images
    assert "active: <controller> gave up & ended" in "".join(reader.text)


def test_an_interrupted_reproduction_says_what_is_kept(tmp_path, monkeypatch, capsys):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("orchestrator.cli.reproduce.reproduce", interrupted)
    assert main(["reproduce", "--out", str(tmp_path)]) == 130
    assert "interrupted; nothing is kept of this reproduction" in capsys.readouterr().err
