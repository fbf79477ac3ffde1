"""State-space models: the classes one states a model with, and the worked systems of the book."""

from pfedu.models.additive import AdditiveGaussian, AdditiveProcess, LinearGaussian, copies
from pfedu.models.conditionally_linear import ConditionallyLinear, positioning
from pfedu.models.falling_body import FallingBody, falling_body
from pfedu.models.jump_markov import JumpMarkov, jump_markov
from pfedu.models.scalar import growth, local_level, random_walk, ratio, stochastic_volatility
from pfedu.models.state_space import MissingPieceError, StateSpaceModel, read_only, require, streams
from pfedu.models.van_der_pol import van_der_pol

__all__ = [
    "AdditiveGaussian",
    "AdditiveProcess",
    "ConditionallyLinear",
    "FallingBody",
    "JumpMarkov",
    "LinearGaussian",
    "MissingPieceError",
    "StateSpaceModel",
    "copies",
    "falling_body",
    "growth",
    "jump_markov",
    "local_level",
    "positioning",
    "random_walk",
    "ratio",
    "read_only",
    "require",
    "stochastic_volatility",
    "streams",
    "van_der_pol",
]
