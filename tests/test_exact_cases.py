"""The catalogue of hard cases through every structure: nothing lost, nothing invented, nothing unlike brute force."""

from rtrace.hard_cases import run_all


def test_every_hard_case_holds_in_every_structure():
    rows = list(run_all())
    assert [row for row in rows if not row.is_good] == []
    assert len({row.case for row in rows}) > 60
    assert sum(row.n_rays for row in rows) > 50_000
