"""What the live page knows of the configuration."""

from dataclasses import dataclass, field

from daemon.decide import ProbabilityModel
from daemon.pipeline import PipelineSettings
from daemon.setup.words import Language, Vocabulary


@dataclass(frozen=True)
class Scene:
    """The pipeline's settings, the model, whether a robot is configured, and words."""

    settings: PipelineSettings
    model: ProbabilityModel
    robot_configured: bool
    words: Vocabulary = field(default_factory=dict)
    language: Language = "en"
