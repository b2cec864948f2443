"""What a run says while it works, and when it is stopped: no minutes without a word, nothing untrue."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import pytest
from support import command_line

import bayesdrill as bd
from bayesdrill.basics.errors import Interrupted

STAGES = (
    "searching the MAP",
    "looking at what the record can show",
    "looking for other maxima",
    "learning the proposal",
    "looking for what the proposal leaves out",
    "starting the walkers",
    "computing the evidence",
    "looking at what the draws say",
    "making tables and figures",
)


@dataclass
class Stopping:
    """Stops the run where a stage begins, or goes on, with this text."""

    at: str = "never"
    stages: list[str] = field(default_factory=list)

    def say(self, text: str) -> None:
        pass

    def update(self, fraction: float, text: str) -> None:
        if fraction == 0:
            self.stages.append(text)
        if self.at in text:
            raise KeyboardInterrupt


def test_each_stage_announces_itself(tmp_path: Path) -> None:
    told = Stopping()
    case = bd.load(command_line.small_config(tmp_path))
    case.run(tmp_path / "out", report=told)
    assert tuple(told.stages) == STAGES
    ran = command_line.cli("report", tmp_path / "out", "--processes", "1")
    assert [f"  {stage} ..." for stage in STAGES[-2:]] == ran.err.splitlines()


STOPS = (
    ("searching", "nothing was found yet, and {} holds the config alone"),
    ("learning", "the maximum is saved in {}, and nothing was sampled yet"),
    ("the walkers", "the maximum is saved in {}, and nothing was sampled yet"),
    (" steps to the next look", "what was sampled is saved in {}"),
    ("the draws", "what was sampled is saved in {}"),
)


def test_what_is_saved_is_said_and_nothing_else(tmp_path: Path) -> None:
    """One run that is stopped again and again, and goes on each time until it is done.

    Mutant killed: one sentence for all that is stopped.
    """
    case, out = bd.load(command_line.small_config(tmp_path)), tmp_path / "out"
    for at, says in STOPS:
        with pytest.raises(Interrupted) as stopped:
            case.run(out, resume=out.exists(), report=Stopping(at))
        assert str(stopped.value) == f"stopped; {says.format(out)}; continue with --resume", at
    assert case.run(out, resume=True).reasons == ()
    assert bd.verify(out).together
