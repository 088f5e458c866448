"""What the live page is told of how answers are made."""

from __future__ import annotations

from dataclasses import dataclass

from daemon.decide import ProbabilityModel
from daemon.pipeline import PipelineSettings


@dataclass(frozen=True)
class Scene:
    """What answers are made with: the pipeline's settings, the model; and whether a robot is configured."""

    settings: PipelineSettings
    model: ProbabilityModel
    robot_configured: bool
