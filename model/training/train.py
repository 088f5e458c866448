"""Training: one command, resumable, deterministic for a seed."""

import copy
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from tqdm import tqdm

from touchd.drivers.recording import NO_TOUCH, Recording
from touchd.model.adapt.augment import as_another_pad, as_quiet_pad, begin_from_rest, crop, vary
from touchd.model.adapt.origin import code_version, data_hash
from touchd.model.adapt.schedule import GRADIENT_LIMIT, learning_rate_at
from touchd.model.tgc import TGC
from touchd.model.training import checkpoint, haart
from touchd.model.training.calibrate import IMPOSSIBLE
from touchd.model.training.checkpoint import Checkpoint, CheckpointError
from touchd.model.training.settings import TrainSettings
from touchd.model.training.studies import MISSING, Folders, study_of

CHECKPOINT_NAME = "checkpoint.pt"
STATES = ("network", "optimizer", "average")
SOURCES = ("haart.py", "settings.py", "train.py")


class Training:
    """One network in training: weights, their moving average, optimizer and random states."""

    def __init__(self, recordings: Sequence[Recording], settings: TrainSettings, device: str) -> None:
        self.settings = settings
        self.device = device
        self.data_sha256 = data_hash(recordings)
        self.labels = tuple(sorted({recording.gesture for recording in recordings}))
        self.counts = [torch.from_numpy(recording.counts.astype(np.float32)) for recording in recordings]
        self.classes = torch.tensor([self.labels.index(recording.gesture) for recording in recordings])
        self.participants = [recording.participant for recording in recordings]
        people = Counter(self.participants)
        in_study = Counter(study_of(participant) for participant in people)
        self.weights = torch.tensor(
            [1.0 / people[participant] / in_study[study_of(participant)] for participant in self.participants]
        )
        self.soft = torch.tensor([study_of(each) == "third" for each in self.participants])
        self.resting: dict[str, list[int]] = {participant: [] for participant in people}
        for i, recording in enumerate(recordings):
            if recording.gesture == NO_TOUCH:
                self.resting[recording.participant].append(i)
        torch.manual_seed(settings.seed)
        self.rng = torch.Generator().manual_seed(settings.seed)
        self.network = TGC(settings.network, len(self.labels)).to(device)
        self.average = copy.deepcopy(self.network)
        self._bfloat16 = settings.bfloat16 and computes_bfloat16(device)
        self._at_lengths: Callable[[Tensor, tuple[int, ...]], Tensor] = self.network.at_lengths
        if settings.compiled:
            self._at_lengths = torch.compile(self.network.at_lengths, dynamic=False)
        self.optimizer = torch.optim.AdamW(self.network.parameters(), weight_decay=settings.weight_decay)
        self.set_aside: list[dict[str, Tensor]] = []
        self.begun_with: dict[str, Tensor] = {}
        self.epoch = 0

    @property
    def steps_per_epoch(self) -> int:
        """How many batches of random crops make an epoch."""
        return len(self.counts) * self.settings.crops_per_recording // self.settings.batch

    def run_epoch(self) -> float:
        """Train one epoch; return the mean loss."""
        settings = self.settings
        order = self._order()
        total = 0.0
        for batch in range(self.steps_per_epoch):
            chosen = order[batch * settings.batch : (batch + 1) * settings.batch]
            windows = torch.stack([self._window(recording) for recording in chosen.tolist()])
            soft = self.soft[chosen]
            windows[~soft] = as_another_pad(windows[~soft], settings.augmentation, self.rng)
            windows[~soft] = as_quiet_pad(windows[~soft], settings.augmentation, self.rng)
            windows = vary(windows, settings.augmentation, self.rng)
            targets = functional.one_hot(self.classes[chosen], len(self.labels)).float()
            windows, targets, soft = self._mix(windows, targets, soft)
            possible = self._possible(targets, soft)
            step = self.epoch * self.steps_per_epoch + batch
            total += self._step(
                windows.to(self.device), targets.to(self.device), possible.to(self.device), step
            )
        self.epoch += 1
        if self.epoch in settings.averaged_epochs:
            self.set_aside.append(copy.deepcopy(self.average.state_dict()))
        return total / self.steps_per_epoch

    def _order(self) -> Tensor:
        """Return the indices of the recordings that an epoch's windows are cut from."""
        passes, count = self.settings.crops_per_recording, len(self.counts)
        if self.settings.balance_people:
            return torch.multinomial(self.weights, passes * count, replacement=True, generator=self.rng)
        return torch.cat([torch.randperm(count, generator=self.rng) for _ in range(passes)])

    def _window(self, recording: int) -> Tensor:
        settings = self.settings
        window = crop(self.counts[recording], settings.window, settings.augmentation, self.rng)
        resting = self.resting[self.participants[recording]]
        if not resting:
            return window
        rest = self.counts[resting[int(torch.randint(len(resting), (1,), generator=self.rng))]]
        still = crop(rest, settings.window, settings.augmentation, self.rng)
        return begin_from_rest(window, still, settings.augmentation, self.rng)

    def _possible(self, targets: Tensor, soft: Tensor) -> Tensor:
        """Return (B, classes) bool, the answers that the loss compares: the third study has no tickle.

        Without this, "tickle" would become evidence for the other studies' pad.
        """
        possible = torch.ones_like(targets, dtype=torch.bool)
        for gesture in {*MISSING["third"]} & {*self.labels}:
            missing = self.labels.index(gesture)
            possible[:, missing] = ~soft | (targets[:, missing] > 0)
        return possible

    def _mix(self, windows: Tensor, targets: Tensor, soft: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Blend some windows (B, T, 8, 8) with others, on the scale that the network sees.

        soft: (B,) bool, whether a window of the third study's pad takes part.
        """
        B = len(windows)
        share = 0.5 * torch.rand(B, generator=self.rng)
        share = share * (torch.rand(B, generator=self.rng) < self.settings.augmentation.mix)
        other = torch.randperm(B, generator=self.rng)
        part, knee = share[:, None, None, None], self.settings.network.knee_counts
        mixed = (windows + knee) ** (1.0 - part) * (windows[other] + knee) ** part - knee
        blended = targets * (1.0 - share[:, None]) + targets[other] * share[:, None]
        return mixed, blended, soft | (soft[other] & (share > 0))

    def _step(self, windows: Tensor, targets: Tensor, possible: Tensor, step: int) -> float:
        settings = self.settings
        epochs = settings.rate_epochs or settings.epochs
        for group in self.optimizer.param_groups:
            group["lr"] = learning_rate_at(step, epochs * self.steps_per_epoch, settings.learning_rate)
        self.network.train()
        with torch.autocast(self.device, torch.bfloat16, enabled=self._bfloat16):
            logits = self._at_lengths(windows, settings.lengths).float()
        logits = logits.masked_fill(~possible[:, None], IMPOSSIBLE)
        expected = torch.lerp(targets, possible / possible.sum(dim=1, keepdim=True), settings.label_smoothing)
        loss = -(expected[:, None] * functional.log_softmax(logits, dim=-1)).sum(dim=-1).mean()
        self.optimizer.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), GRADIENT_LIMIT)
        self.optimizer.step()
        self._follow(step)
        return float(loss.item())

    @torch.no_grad()
    def _follow(self, step: int) -> None:
        # The average would remember the random start, so it follows fast at first.
        decay = min(self.settings.average_decay, (step + 1) / (step + 10))
        for slow, fast in zip(self.average.parameters(), self.network.parameters(), strict=True):
            slow.lerp_(fast, 1.0 - decay)

    def snapshot(self) -> Checkpoint:
        """Return the state as a checkpoint."""
        training: dict[str, Any] = {
            **{name: getattr(self, name).state_dict() for name in STATES},
            "rng": self.rng.get_state(),
            "torch_rng": torch.get_rng_state(),
            "set_aside": self.set_aside,
            "begun_with": self.begun_with,
        }
        kept = self.set_aside or [self.average.state_dict()]
        network = {name: torch.stack([each[name] for each in kept]).mean(dim=0).cpu() for name in kept[0]}
        for name, weights in self.begun_with.items():
            network[name] = torch.lerp(network[name], weights, self.settings.begins_share)
        return Checkpoint(
            settings=self.settings,
            labels=self.labels,
            epoch=self.epoch,
            network=network,
            training=training,
            code_version=code_version(*(Path(__file__).with_name(name) for name in SOURCES)),
            data_sha256=self.data_sha256,
        )

    def begin_with(self, earlier: Checkpoint) -> None:
        """Begin with the weights of an earlier training.

        Raises CheckpointError if it learnt from somebody whom this one holds out.
        """
        first = earlier.settings
        left_out = {name for name in self.settings.left_out if study_of(name) in first.studies}
        if seen := sorted(left_out - {*first.left_out}):
            raise CheckpointError(f"{self.settings.begins_from} may have learnt from {', '.join(seen)}")
        for network in (self.network, self.average):
            network.load_state_dict(earlier.network)
        self.begun_with = earlier.network

    def resume(self, saved: Checkpoint) -> None:
        """Resume from `saved`; raises CheckpointError when it is of another training."""
        if saved.settings != self.settings or saved.data_sha256 != self.data_sha256:
            raise CheckpointError(
                "the checkpoint there was made with other settings or data; choose another folder"
            )
        for name in STATES:
            getattr(self, name).load_state_dict(saved.training[name])
        self.set_aside = saved.training["set_aside"]
        self.begun_with = saved.training["begun_with"]
        self.rng.set_state(saved.training["rng"])
        torch.set_rng_state(saved.training["torch_rng"])
        self.epoch = saved.epoch


def train(recordings: Sequence[Recording], settings: TrainSettings, folder: Path, device: str) -> Checkpoint:
    """Train on realigned recordings; save each epoch in `folder`, resume from the last one."""
    path = folder / CHECKPOINT_NAME
    training = Training(recordings, settings, device)
    if path.exists():
        training.resume(checkpoint.load(path))
    elif settings.begins_from:
        training.begin_with(checkpoint.load(folder.parent / settings.begins_from / CHECKPOINT_NAME))
    with tqdm(total=settings.epochs, initial=training.epoch, unit="epoch", desc=folder.name) as progress:
        while training.epoch < settings.epochs:
            loss = training.run_epoch()
            checkpoint.save(training.snapshot(), path)
            progress.set_postfix(loss=f"{loss:.3f}")
            progress.update()
    return training.snapshot()


def train_studies(folders: Folders, settings: TrainSettings, folder: Path, threads: int) -> Checkpoint:
    """Train on the people of the studies in `settings`, without those held out."""
    torch.set_num_threads(threads)
    recordings = haart.without(folders.to_train_on(settings.studies), settings.left_out)
    return train(recordings, settings, folder, fastest_device())


def computes_bfloat16(device: str) -> bool:
    """Whether a device has instructions for bfloat16; without, a step takes ten times as long."""
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # Older releases of PyTorch do not say.
    has: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(has.get("avx512_bf16") or has.get("amx_bf16"))


def fastest_device() -> str:
    """Return "cuda" where there is a GPU, else "cpu"."""
    return "cuda" if torch.cuda.is_available() else "cpu"
