"""The comparison with DineroIV's program, by a stand-in for it that prints what it is told."""

import sys

import numpy as np
import pytest

from tests import dinero


@pytest.fixture
def program(tmp_path, monkeypatch):
    """Return a function: a change of our block of the first case -> the status of the comparison with one that prints that."""
    random = np.random.default_rng([3, 0])
    case = dinero.random_case(random)
    (tmp_path / "x.din").write_bytes(dinero.random_trace(random, case))
    block = case.block(tmp_path / "x.din")
    stand_in = tmp_path / "dinero"
    stand_in.write_text(f'#!/bin/sh\ncat > {tmp_path}/trace; echo "$@" > {tmp_path}/options; cat {tmp_path}/printed\n')
    stand_in.chmod(0o755)
    monkeypatch.chdir(tmp_path)

    def status(old="", new=""):
        assert old in block
        words = f"---Simulation complete.\n{block.replace(old, new, 1)}---Execution complete.\n"
        (tmp_path / "printed").write_text(words)
        monkeypatch.setattr(sys, "argv", ["dinero", str(stand_in), "--cases", "1", "--seed", "3", "-o", "found.json"])
        with pytest.raises(SystemExit) as end:
            dinero.main()
        assert (tmp_path / "options").read_text().split() == case.options()
        assert (tmp_path / "trace").read_bytes() == (tmp_path / "x.din").read_bytes()
        return end.value.code

    return status


def test_equal_blocks_are_no_difference(program, tmp_path):
    assert program() == 0
    assert '"different": 0' in (tmp_path / "found.json").read_text()


def test_a_counter_that_differs_is_one_and_its_trace_is_kept(program, tmp_path, capsys):
    assert program("Demand Misses", "Demand Missed") == 1
    assert (tmp_path / "different-3-0.din").read_bytes() == (tmp_path / "x.din").read_bytes()
    assert "Demand Missed" in capsys.readouterr().out and '"different": 1' in (tmp_path / "found.json").read_text()
