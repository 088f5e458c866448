"""What the live page is told of how answers are made."""

from __future__ import annotations

from dataclasses import dataclass, field

from daemon.decide import ProbabilityModel
from daemon.pipeline import PipelineSettings
from daemon.setup.words import Language, Vocabulary


@dataclass(frozen=True)
class Scene:
    """What answers are made with: the pipeline's settings, the model, whether there is a robot, and words."""

    settings: PipelineSettings
    model: ProbabilityModel
    robot_configured: bool
    words: Vocabulary = field(default_factory=dict)
    language: Language = "en"
