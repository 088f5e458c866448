"""Trains and exports the detectors: `python -m touchd.model.studies detector`, from the repository's root."""

import sys
from collections.abc import Sequence
from pathlib import Path

import msgspec
import torch
import yaml

from touchd.model.classifier import SHIPPED_MODEL
from touchd.model.detector import SHIPPED_DETECTOR
from touchd.model.studies.folders import study_parser
from touchd.model.training.detector.data import composer
from touchd.model.training.detector.export import export
from touchd.model.training.detector.train import DetectorSettings, train
from touchd.model.training.studies import Folders

RECIPE = Path(__file__).parents[2] / "detector" / "recipe.yaml"
NEVER_MET = "third"


class DetectorRecipe(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The detectors to train; folds: people whom one of them never sees."""

    name: str
    seed: int
    steps: int
    batch: int
    learning_rate: float
    folds: tuple[tuple[str, ...], ...]

    def jobs(self) -> dict[str, DetectorSettings]:
        """Return the settings of each detector by the name of its file."""
        base = DetectorSettings(
            name=self.name,
            seed=self.seed,
            steps=self.steps,
            batch=self.batch,
            learning_rate=self.learning_rate,
        )
        return {
            SHIPPED_DETECTOR.stem: base,
            "fabric": msgspec.structs.replace(base, left_out_study=NEVER_MET),
            **{
                f"fold{i}": msgspec.structs.replace(base, left_out=own) for i, own in enumerate(self.folds, 1)
            },
        }


def main(arguments: Sequence[str]) -> int:
    """Train what is not trained yet, resuming where a training was cut off, and export it; returns 0."""
    parser = study_parser(
        "detector", "Trains and exports the detectors.", "haart", "second-study", "third-study"
    )
    parser.add_argument("--runs", type=Path, default=Path("runs/detector"), help="folder for checkpoints")
    parser.add_argument("--only", default="", help="one of them by its name")
    parser.add_argument(
        "--weights", type=Path, default=SHIPPED_MODEL.parent, help="folder of the model files"
    )
    chosen = parser.parse_args(arguments)
    torch.set_num_threads(1)
    recipe = msgspec.convert(yaml.safe_load(RECIPE.read_text(encoding="utf-8")), DetectorRecipe)
    folders = Folders(chosen.haart, chosen.second_study, chosen.third_study)
    for name, settings in recipe.jobs().items():
        if chosen.only in ("", name):
            network = train(composer(folders, settings), settings, chosen.runs / name)
            path = chosen.weights / SHIPPED_DETECTOR.parent.name / f"{name}.onnx"
            export(network, msgspec.to_builtins(settings), path)
            sys.stdout.write(f"{path}\n")
    return 0
