"""The soak: a short run passes, and its audit detects wrong events."""

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from by_hand.soak import Soak
from rigs.audit import Audit
from rigs.made_events import PREDICTION
from rigs.soak_line import pad

from touchd.daemon.path.events import Event, Prediction, TouchBegan, TouchEnded

ROOT = Path(__file__).parents[2]
BEGAN = TouchBegan(touch=1, time="", sensor_ms=0)
ENDED = TouchEnded(touch=1, gesture="rub", frames=200, reason="released", time="")


def final(touch: int = 1, **changes: Any) -> Prediction:
    values: dict[str, Any] = {"stage": "final", "frames": 144, "gesture": "rub"}
    return msgspec.structs.replace(PREDICTION, touch=touch, **(values | changes))


@pytest.mark.slow
def test_a_short_soak_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TOUCHD_HAART", raising=False)
    with pad() as line:
        figures = Soak(tmp_path).run(line, hours=0.012)
    holds = figures["holds"]
    assert isinstance(holds, dict)
    assert [what for what, held in holds.items() if not held] == []


@pytest.mark.parametrize(
    "events",
    [
        [BEGAN, ENDED],
        [BEGAN, final(), final(), ENDED],
        [BEGAN, final(2), ENDED],
        [BEGAN, BEGAN],
        [BEGAN, final(), ENDED, BEGAN],
        [BEGAN, final(), ENDED, ENDED],
        [final()],
        [BEGAN, final(), final(stage="ongoing", changed=False)],
        [BEGAN, final(gesture="notouch")],
        [BEGAN, final(changed=False)],
        [BEGAN, final(), msgspec.structs.replace(ENDED, gesture="pat")],
    ],
    ids=[
        *("no answer", "answered twice", "answer of another", "two at once", "number twice", "two ends"),
        *("no touch", "told twice", "notouch told", "change hidden", "ends as another"),
    ],
)
def test_missing_and_double_answers_are_found(events: list[Event]) -> None:
    audit = Audit()
    for event in events:
        audit.see(event)
    assert len(audit.wrong) >= 1


def test_a_correct_touch_passes_the_audit() -> None:
    audit = Audit()
    for event in [BEGAN, final(), ENDED]:
        audit.see(event)
    assert not audit.wrong


def test_the_published_soak_passed_under_the_services_settings() -> None:
    published = json.loads((ROOT / "model/studies/stored/soak.json").read_text(encoding="utf-8"))
    assert published["sensor_hours"] >= 24.0
    assert [what for what, held in published["holds"].items() if not held] == []
    unit = (ROOT / "systemd" / "touchd.service").read_text(encoding="utf-8")
    assert f"Environment=MALLOC_MMAP_THRESHOLD_={published['malloc_mmap_threshold']}\n" in unit
