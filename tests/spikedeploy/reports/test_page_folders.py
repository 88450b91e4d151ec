"""The folders of pages: what is written there, and what is not overwritten."""

import json

DRIFT = ("drift", "stroll/popsan", "--random", "0.3", "--steps", "5")
CHECK = ("check", "stroll/popsan", "--chip", "loihi1")


def test_drift_and_check_write_a_page_and_the_numbers_that_they_print(stroll, command):
    for words in (DRIFT, CHECK):
        code, out, err = command(*words, "-o", "out/" + words[0], "--json")
        assert code == 0, err
        page, numbers = (stroll / "out" / words[0] / f"report.{end}" for end in ("html", "json"))
        assert page.read_text().startswith("<!doctype html>")
        assert json.loads(out).items() <= json.loads(numbers.read_text()).items()


def test_a_page_is_written_again_by_its_command_and_by_no_other(stroll, command):
    assert command(*CHECK, "-o", "out")[0] == 0
    assert command(*CHECK, "-o", "out")[0] == 0
    before = (stroll / "out/report.json").read_bytes()
    for words in (DRIFT, ("run", "gait", "--env", "stroll")):
        code, _, err = command(*words, "-o", "out")
        assert (code, "--force" in err) == (2, True)
    assert (stroll / "out/report.json").read_bytes() == before
    assert command(*DRIFT, "-o", "out", "--force")[0] == 0
