"""Sweeps and searches write into folders of their own, and keep what is not theirs."""

import pytest

from spikedeploy.campaign.sweep import is_sweep
from spikedeploy.campaign.tune_results import PAGE, is_study
from spikedeploy.exporters.c.refusals import check_prefix
from spikedeploy.runtime.errors import ConfigError

SPEC = "env = 'kart-grid'\npolicy = 'gap'\nepisodes = 1\n"


def test_a_journal_of_somebody_else_is_no_sweep_and_stays(tmp_path, command):
    spec = tmp_path / "grid.toml"
    spec.write_text(SPEC)
    (tmp_path / "mine").mkdir()
    diary = tmp_path / "mine" / "journal.csv"
    diary.write_text("dear diary\n")
    code, _, err = command("sweep", str(spec), "-o", str(tmp_path / "mine"))
    assert code == 2
    assert "journal.csv" in err
    assert diary.read_text() == "dear diary\n"
    assert not is_sweep(tmp_path / "mine")


def test_a_page_without_results_is_a_sweep_that_goes_on(tmp_path, command):
    spec = tmp_path / "grid.toml"
    spec.write_text(SPEC)
    for more in ("--no-run", "--no-run"):
        assert command("sweep", str(spec), "-o", str(tmp_path / "out"), more)[0] == 0
    assert is_sweep(tmp_path / "out")


def test_notes_and_journals_of_somebody_else_are_no_search(tmp_path):
    (tmp_path / PAGE).write_text("my notes")
    assert not is_study(tmp_path)
    (tmp_path / "journal.log").write_text("my log")
    assert not is_study(tmp_path)
    (tmp_path / "journal.log").write_text('{"op_code": 0, "worker_id": "x"}\n')
    assert is_study(tmp_path)


@pytest.mark.parametrize("prefix", ["codec", "selftest", "vectors"])
def test_the_files_of_an_export_to_c_do_not_replace_one_another(prefix):
    with pytest.raises(ConfigError, match=prefix):
        check_prefix(prefix)
    check_prefix("walker")
