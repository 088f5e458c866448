"""Trains networks of one shape in parallel, each on its own people; resumable.

A GPU trains several networks in hardly more time than one. So their weights are stacked, with the network as
the first dimension, and one step of all networks is recorded as a CUDA graph.
"""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import torch
from torch import Tensor, nn
from torch.func import functional_call, vmap
from torch.nn import functional
from tqdm import tqdm

from touchd.drivers.recording import Recording
from touchd.model.adapt.adapt import code_version, data_hash
from touchd.model.adapt.head import GRADIENT_LIMIT, learning_rate_at
from touchd.model.tgc import TGC
from touchd.model.training import checkpoint
from touchd.model.training.calibrate import IMPOSSIBLE
from touchd.model.training.checkpoint import Checkpoint, CheckpointError
from touchd.model.training.recipe import Job
from touchd.model.training.settings import TrainSettings
from touchd.model.training.windows import WindowSampler, learns

CHECKPOINT_NAME = "checkpoint.pt"
SOURCES = ("contacts.py", "haart.py", "passing.py", "settings.py", "train.py", "windows.py")
SAVED_EVERY_S = 60.0
# PyTorch requires some steps before one is recorded (CUDA semantics, "CUDA graphs").
STEPS_BEFORE_GRAPH = 3
MOMENTS = ("exp_avg", "exp_avg_sq")
Weights = dict[str, Tensor]
"""By name, (N, ...) of N networks."""
Ask = Callable[[Weights, Tensor, Tensor], Tensor]
"""From weights, windows (N, B, T, 8, 8) and lengths (N, B, K) to logits (N, B, K, classes)."""


class AtLengths(nn.Module):
    """The network as training calls it: logits at several lengths of each window."""

    def __init__(self, network: TGC) -> None:
        super().__init__()
        self.network = network

    def forward(self, windows: Tensor, lengths: Tensor) -> Tensor:
        return self.network.at_lengths(windows, lengths)


class Training:
    """N networks in training: weights, their moving averages, optimizer.

    settings: one a network; they differ in name, seed and whom they learn from.
    """

    def __init__(
        self, recordings: Sequence[Recording], settings: Sequence[TrainSettings], device: str
    ) -> None:
        if len({_shared(each) for each in settings}) != 1:
            raise ValueError("only networks of one shape and schedule train in parallel")
        if any(len(recording.counts) <= settings[0].window for recording in recordings):
            raise ValueError(f"a recording is no longer than a window, {settings[0].window} frames")
        self.recordings = recordings
        self.each = tuple(settings)
        self.data_sha256 = [
            data_hash(recording for recording in recordings if learns(own, recording)) for own in settings
        ]
        self.settings = settings[0]
        self.device = device
        self.sampler = WindowSampler(recordings, settings, device)
        self.labels = self.sampler.labels
        self.rng = self.sampler.rng

        self.weights = _first_weights(settings, len(self.labels), device)
        self.average = {name: weights.detach().clone() for name, weights in self.weights.items()}
        base = AtLengths(TGC(self.settings.network, len(self.labels))).to(device)
        self._ask = torch.compile(vectorized(base)) if device == "cuda" else sequential(base)
        self._bfloat16 = self.settings.bfloat16 and computes_bfloat16(device)
        self.rate = torch.zeros((), device=device)
        self.follow = torch.zeros((), device=device)
        self.loss = torch.zeros(len(settings), device=device)
        self.optimizer = torch.optim.AdamW(
            self.weights.values(),
            lr=self.rate,
            weight_decay=self.settings.weight_decay,
            capturable=device == "cuda",
        )
        torch.manual_seed(self.settings.seed)
        self.step = 0
        self._steps_here = 0
        self._graph: torch.cuda.CUDAGraph | None = None

    def run(self, steps: int) -> None:
        """Train all networks for a number of steps."""
        for _ in range(steps):
            self.rate.fill_(learning_rate_at(self.step, self.settings.steps, self.settings.learning_rate))
            # The average follows fast at first, so that it forgets the initial weights.
            self.follow.fill_(1.0 - min(self.settings.average_decay, (self.step + 1) / (self.step + 10)))
            self._take_step()
            self.step += 1

    def _take_step(self) -> None:
        if self.device != "cuda":
            self._learn()
        elif self._graph is not None:
            self._graph.replay()
        elif self._steps_here < STEPS_BEFORE_GRAPH:
            beside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
            beside.wait_stream(torch.cuda.current_stream())
            with torch.cuda.stream(beside):
                self._learn()
            torch.cuda.current_stream().wait_stream(beside)
            self._steps_here += 1
        else:
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self._learn()
            self._graph.replay()

    def _learn(self) -> None:
        with torch.no_grad():
            batch = self.sampler.draw()
        with torch.autocast(self.device, torch.bfloat16, enabled=self._bfloat16, cache_enabled=False):
            logits = self._ask(self.weights, batch.windows, batch.lengths).float()
        logits = logits.masked_fill(~batch.possible[:, :, None], IMPOSSIBLE)
        even = batch.possible / batch.possible.sum(dim=-1, keepdim=True)
        expected = torch.lerp(batch.targets, even, self.settings.label_smoothing)
        losses = -(expected[:, :, None] * functional.log_softmax(logits, dim=-1)).sum(dim=-1)
        losses = (losses * batch.weights).mean(dim=(1, 2))
        self.loss.copy_(losses.detach())
        gradients = torch.autograd.grad(losses.sum(), list(self.weights.values()))
        lengths = torch.stack([each.flatten(1).square().sum(dim=1) for each in gradients]).sum(dim=0).sqrt()
        limit = (GRADIENT_LIMIT / (lengths + 1e-6)).clamp_max(1.0)
        for weights, gradient in zip(self.weights.values(), gradients, strict=True):
            weights.grad = gradient * limit.reshape(-1, *[1] * (gradient.dim() - 1))
        self.optimizer.step()
        with torch.no_grad():
            # One kernel for all weights instead of one for each.
            averages = list(self.average.values())
            changes = torch._foreach_sub(list(self.weights.values()), averages)
            torch._foreach_mul_(changes, self.follow)
            torch._foreach_add_(averages, changes)

    def snapshots(self) -> list[Checkpoint]:
        """Return each network's state as a checkpoint."""
        return [self._snapshot(place, own) for place, own in enumerate(self.each)]

    def _snapshot(self, place: int, own: TrainSettings) -> Checkpoint:
        def of(stack: dict[str, Tensor]) -> dict[str, Tensor]:
            return {
                name.removeprefix("network."): values[place].detach().cpu().clone()
                for name, values in stack.items()
            }

        return Checkpoint(
            settings=own,
            labels=self.labels,
            step=self.step,
            network=of(self.average),
            training={
                "weights": of(self.weights),
                **{moment: of(self._moments(moment)) for moment in MOMENTS},
                "rng": self.rng.get_state(),
            },
            code_version=code_version(*(Path(__file__).with_name(name) for name in SOURCES)),
            data_sha256=self.data_sha256[place],
        )

    def _moments(self, moment: str) -> dict[str, Tensor]:
        state = self.optimizer.state
        return {
            name: state[weights][moment] if weights in state else torch.zeros_like(weights)
            for name, weights in self.weights.items()
        }

    def begin_from(self, trained: Sequence[Checkpoint]) -> None:
        """Begin from the networks of these trainings, one each."""
        for name, own_weights in self.weights.items():
            networks = [each.network[name.removeprefix("network.")] for each in trained]
            own_weights.data.copy_(torch.stack(networks))
            self.average[name].copy_(own_weights.detach())

    def resume(self, saved: Sequence[Checkpoint]) -> None:
        """Resume all networks from the same step; raises CheckpointError if one is of another training."""
        for own, data_sha256, of in zip(self.each, self.data_sha256, saved, strict=True):
            if of.settings != own or of.data_sha256 != data_sha256 or of.step != saved[0].step:
                raise CheckpointError(
                    "the checkpoint there was made with other settings or data; choose another folder"
                )

        def stacked(states: Sequence[dict[str, Tensor]]) -> dict[str, Tensor]:
            return {
                name: torch.stack([state[name.removeprefix("network.")] for state in states]).to(self.device)
                for name in self.weights
            }

        weights = stacked([of.training["weights"] for of in saved])
        average = stacked([of.network for of in saved])
        moments = {moment: stacked([of.training[moment] for of in saved]) for moment in MOMENTS}
        self.step = saved[0].step
        for name, own_weights in self.weights.items():
            own_weights.data.copy_(weights[name])
            self.average[name].copy_(average[name])
            self.optimizer.state[own_weights] = {
                "step": torch.tensor(float(self.step), device=self.device),
                **{moment: moments[moment][name] for moment in MOMENTS},
            }
        try:
            self.rng.set_state(saved[0].training["rng"])
        except RuntimeError as error:
            raise CheckpointError(
                f"training cannot go on on this device ({self.device}), only on the kind on which it began"
            ) from error


def _first_weights(settings: Sequence[TrainSettings], classes: int, device: str) -> dict[str, Tensor]:
    """Return the weights of new networks, (N, ...) by name."""
    networks = []
    for own in settings:
        torch.manual_seed(own.seed)
        networks.append(dict(TGC(own.network, classes).named_parameters(prefix="network")))
    return {
        name: torch.stack([network[name].detach() for network in networks]).to(device).requires_grad_()
        for name in networks[0]
    }


def train(recordings: Sequence[Recording], jobs: Sequence[Job], runs: Path, device: str) -> list[Checkpoint]:
    """Train networks side by side on whole scans; save them in `runs` once a minute, resume from there.

    All must have been saved after the same step, or none.
    """
    paths = [runs / job.name / CHECKPOINT_NAME for job in jobs]
    training = _begun(Training(recordings, [job.settings for job in jobs], device), jobs, runs, paths)
    name = jobs[0].name if len(jobs) == 1 else f"{len(jobs)} networks"
    steps = training.settings.steps
    saved_at = time.monotonic()
    with tqdm(total=steps, initial=training.step, unit="step", desc=name) as progress:
        while training.step < steps:
            training.run(min(20, steps - training.step))
            progress.update(training.step - progress.n)
            if training.step == steps or time.monotonic() - saved_at > SAVED_EVERY_S:
                progress.set_postfix(loss=f"{float(training.loss.mean()):.3f}")
                for snapshot, path in zip(training.snapshots(), paths, strict=True):
                    checkpoint.save(snapshot, path)
                saved_at = time.monotonic()
    return training.snapshots()


def _begun(training: Training, jobs: Sequence[Job], runs: Path, paths: Sequence[Path]) -> Training:
    """Resume a training if it was saved, or begin from other networks."""
    if any(path.exists() for path in paths):
        training.resume([checkpoint.load(path) for path in paths])
    elif jobs[0].begins_from is not None:
        begins = [runs / str(job.begins_from) / CHECKPOINT_NAME for job in jobs]
        training.begin_from([checkpoint.load(path) for path in begins])
    return training


def vectorized(network: nn.Module) -> Ask:
    """Return a vmapped forward of stacked networks, for a GPU."""

    def ask(weights: Weights, windows: Tensor, lengths: Tensor) -> Tensor:
        return functional_call(network, weights, (windows, lengths))  # type: ignore[no-any-return]

    return vmap(ask, randomness="different")


def sequential(network: nn.Module) -> Ask:
    """Return a forward that calls stacked networks one after the other."""

    def ask(weights: Weights, windows: Tensor, lengths: Tensor) -> Tensor:
        each = ({name: values[place] for name, values in weights.items()} for place in range(len(windows)))
        seen = zip(each, windows, lengths, strict=True)
        return torch.stack([functional_call(network, own, (of, at)) for own, of, at in seen])

    return ask


def _shared(settings: TrainSettings) -> TrainSettings:
    """Return the settings that networks trained in parallel must have in common."""
    return msgspec.structs.replace(settings, name="", seed=0, left_out=(), studies=())


def computes_bfloat16(device: str) -> bool:
    """Whether a device has instructions for bfloat16; without them, a step takes ten times as long."""
    if device == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    # Older releases of PyTorch lack the function.
    has: dict[str, object] = getattr(torch.cpu, "get_capabilities", dict)()
    return bool(has.get("avx512_bf16") or has.get("amx_bf16"))


def fastest_device() -> str:
    """Return "cuda" where there is a GPU, else "cpu"."""
    return "cuda" if torch.cuda.is_available() else "cpu"
