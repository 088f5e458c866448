"""The paper's network, as printed and as in its public code."""

import pytest

pytest.importorskip("torch", reason="needs the extra `train`")

import torch
from torch import nn

from touchd.model.studies.report.paper_tgc import Attention, FeedForward, PaperSettings, PaperTGC


def parameters(network: nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_the_printed_block_is_the_encoder_block_of_pytorch() -> None:
    torch.manual_seed(0)
    attention, forward = Attention(32, 4, 0.1).eval(), FeedForward(32, 64, 0.1).eval()
    theirs = nn.TransformerEncoderLayer(32, 4, 64, dropout=0.1, batch_first=True).eval()
    query_key_value = (attention.query, attention.key, attention.value)
    theirs.load_state_dict(
        {
            "self_attn.in_proj_weight": torch.cat([layer.weight for layer in query_key_value]),
            "self_attn.in_proj_bias": torch.cat([layer.bias for layer in query_key_value]),
            "self_attn.out_proj.weight": attention.project.weight,
            "self_attn.out_proj.bias": attention.project.bias,
            "linear1.weight": forward.layers[0].weight,
            "linear1.bias": forward.layers[0].bias,
            "linear2.weight": forward.layers[2].weight,
            "linear2.bias": forward.layers[2].bias,
            "norm1.weight": attention.norm.weight,
            "norm1.bias": attention.norm.bias,
            "norm2.weight": forward.norm.weight,
            "norm2.bias": forward.norm.bias,
        }
    )
    x = torch.randn(2, 9, 32)
    with torch.no_grad():
        torch.testing.assert_close(forward(attention(x)), theirs(x), rtol=1e-5, atol=1e-5)


def test_both_networks_have_the_published_sizes() -> None:
    embedding, attention = 64 * 512 + 512, 4 * (512 * 512 + 512) + 2 * 512
    feed_forward = 512 * 2048 + 2048 + 2048 * 512 + 512 + 2 * 512
    dense = (512 * 128 + 128) + (128 * 16 + 16) + (16 * 4 + 4) + (144 * 4 * 7 + 7)
    printed, public = (PaperTGC(PaperSettings(variant), 7) for variant in ("printed", "public"))
    assert parameters(printed) == embedding + 6 * (attention + feed_forward) + dense
    assert parameters(public) == 2 * 144 + embedding + 6 * attention + dense
    assert sum(isinstance(layer, nn.ReLU) for layer in printed.dense) == 0
    assert sum(isinstance(layer, nn.ReLU) for layer in public.dense) == 3
    assert public.input_norm.num_features == 144


@pytest.mark.parametrize("variant", ["printed", "public"])
@pytest.mark.parametrize("frames", [9, 72])
def test_each_answers_at_its_own_length(variant: str, frames: int) -> None:
    settings = PaperSettings(variant, frames, blocks=1, width=16, heads=4, inner=32)  # type: ignore[arg-type]
    network = PaperTGC(settings, 7).eval()
    with torch.no_grad():
        assert network(torch.zeros(3, frames, 8, 8)).shape == (3, 7)
    with pytest.raises(RuntimeError):
        network(torch.zeros(3, frames + 1, 8, 8))
