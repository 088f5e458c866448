"""The systems of the paper's table 1, in its order, with the accuracy it prints, and ours after them."""

from __future__ import annotations

from docs.studies.report import challenge_balli, challenge_gaus, challenge_ta
from docs.studies.report.challenge_hughes import AUTOENCODER_RNN, CNN, CRNN
from docs.studies.report.challenge_kinds import HandMade, Network, Searched, Shipped, System

BALLI = "Balli Altuglu and Altun 2015"
TA = "Ta et al. 2015"
GAUS = "Gaus et al. 2015"
HUGHES = "Hughes et al. 2017"
FOREST = "Random forest"

SYSTEMS: tuple[System, ...] = (
    Searched(
        "balli-forest",
        BALLI,
        FOREST,
        61.5,
        features=challenge_balli.features,
        build=challenge_balli.forest,
        names=challenge_balli.NAMES,
    ),
    HandMade(
        "ta-forest",
        TA,
        FOREST,
        70.9,
        features=challenge_ta.features,
        build=challenge_ta.forest,
        options=challenge_ta.FORESTS,
    ),
    HandMade(
        "ta-svm",
        TA,
        "SVM",
        68.5,
        seeds=(0,),
        features=challenge_ta.features,
        build=challenge_ta.machine,
        options=challenge_ta.MACHINES,
    ),
    HandMade(
        "gaus-forest",
        GAUS,
        FOREST,
        66.5,
        features=challenge_gaus.features,
        build=challenge_gaus.forest,
        options=challenge_gaus.FORESTS,
    ),
    HandMade(
        "gaus-boosting",
        GAUS,
        "Multiboosting",
        64.5,
        features=challenge_gaus.features,
        build=challenge_gaus.boosting,
        options=challenge_gaus.BOOSTS,
    ),
    Network("hughes-cnn", HUGHES, CNN, 56.1),
    Network("hughes-crnn", HUGHES, CRNN, 61.4),
    Network("hughes-autoencoder", HUGHES, AUTOENCODER_RNN, 61.4, most_epochs=40),
    Shipped("touchd", "touchd", "One causal network", None),
)
