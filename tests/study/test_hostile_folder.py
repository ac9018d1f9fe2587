"""Folders of studies from elsewhere: tables that unpack to more than the memory holds, and links to files of the user's. Truth: bytes of
the texts that were written; the content of the file that a link leads to."""

from __future__ import annotations

from pathlib import Path

import pyarrow
import pyarrow.parquet as parquet
import pytest

from wbmpc.cli import main
from wbmpc.errors import InputError
from wbmpc.study.files import JOURNAL, LOCK, PAGE, PARTS, ROWS, STATISTICS
from wbmpc.study.store import Store, table_of

ROW = {"key": "a-1", "experiment": "hold", "outcome": "completed", "wall_time": 1.0, "cpu_time": 1.0}
STUDY = "experiments: {hold: {robot: panda}}\nseeds: 1-2\n"


@pytest.mark.parametrize("dictionary", [True, False])
@pytest.mark.parametrize("length", [0, 10_000])
def test_a_small_table_that_unpacks_to_much_is_an_error_before_that(
    length: int, dictionary: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [{**ROW, "key": f"a-{k}"} for k in range(2000)]
    table = table_of(rows)
    reasons = pyarrow.array(["x" * length] * 2000)
    table = table.set_column(table.column_names.index("reason"), "reason", reasons)
    parquet.write_table(table, tmp_path / ROWS, use_dictionary=dictionary, compression="zstd")
    assert (tmp_path / ROWS).stat().st_size < 50_000
    monkeypatch.setattr("wbmpc.study.store.LARGEST_TABLE", 10_000_000, raising=False)
    if length:
        with pytest.raises(InputError, match="unpacks to more than 10000000 bytes"):
            Store(tmp_path).table()
    else:
        read = Store(tmp_path).table()
        assert read.to_pylist() == table.to_pylist() and read.schema.equals(table.schema, check_metadata=True)
    assert Store(tmp_path).table(["key"])["key"].to_pylist() == [row["key"] for row in rows]


@pytest.mark.parametrize("name", [LOCK, JOURNAL, PAGE, STATISTICS])
@pytest.mark.parametrize("there", [True, False])
def test_nothing_is_written_where_links_lead(
    name: str, there: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("study.yaml").write_text(STUDY)
    Path("out").mkdir()
    parquet.write_table(table_of([ROW]), Path("out") / ROWS)
    (Path("out") / name).symlink_to("../precious")
    if there:
        Path("precious").write_text("mine")
    assert main(["study", "study.yaml", "--out", "out", "--report"]) == 2
    assert f"'out/{name}' is a link" in capfd.readouterr().err
    assert Path("precious").read_text() == "mine" if there else not Path("precious").exists()


@pytest.mark.parametrize("name", [LOCK, JOURNAL, PARTS])
def test_a_store_follows_no_links_of_its_own_names(name: str, tmp_path: Path) -> None:
    """As in the folder of a search's trials, and of studies from Python. Truth: the content of the file that a link leads to."""
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "1.parquet").write_text("mine")
    folder = tmp_path / "trials"
    folder.mkdir()
    (folder / name).symlink_to("../elsewhere" if name == PARTS else "../elsewhere/1.parquet")
    with pytest.raises(InputError, match=f"{name}: is a link"), Store(folder):
        pass
    assert (tmp_path / "elsewhere" / "1.parquet").read_text() == "mine"
