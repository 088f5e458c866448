"""Whether a scene and words, where they are configured, fit the model."""

from collections.abc import Iterable

from touchd.daemon.app.config import ConfigError, SceneSettings
from touchd.daemon.path.events import UNCERTAIN
from touchd.drivers.frame import NO_TOUCH, OTHER
from touchd.model.classifier import Classifier


def check_words(words: Iterable[str], models: Iterable[Classifier]) -> None:
    """Raise ConfigError when there are words for a gesture that no pad's model knows."""
    known = {OTHER, UNCERTAIN}.union(*(model.labels for model in models))
    if unknown := sorted(set(words) - known):
        raise ConfigError(f"words.{unknown[0]}: unknown gesture; known: {', '.join(sorted(known))}")


def check_scene(scene: SceneSettings, classifier: Classifier) -> None:
    """Raise ConfigError when a scene asks for gestures or lengths that the model or the scene rules out."""
    known = set(classifier.labels) - {NO_TOUCH}
    acted_on = {gesture for rule in scene.actions for gesture in rule.gestures} - {OTHER, UNCERTAIN}
    for name, gestures in (("scene.gestures", set(scene.gestures)), ("scene.actions", acted_on)):
        if unknown := sorted(gestures - known):
            raise ConfigError(
                f"{name}: {unknown[0]} is not a gesture of the model {classifier.name}; "
                f"it knows {', '.join(sorted(known))}: name those, or leave {name} out"
            )
    if scene.gestures and (never := sorted(acted_on - set(scene.gestures))):
        raise ConfigError(
            f"scene.actions: {never[0]} is never told, as scene.gestures leaves it out; add it there, or "
            "remove it here"
        )
    longest = classifier.metadata.max_length
    if scene.answer_at_frames[-1] > longest:
        raise ConfigError(
            f"scene.answer_at_frames: {scene.answer_at_frames[-1]} is more than "
            f"the {longest} frames that the model {classifier.name} takes"
        )
