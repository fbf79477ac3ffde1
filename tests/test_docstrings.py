"""Every public name of the core tells its parameters, what it gives back, and shows an example."""

import ast
import importlib
import inspect
import re
import textwrap

import pytest

CORE = [
    "weights",
    "gaussian",
    "resampling",
    "models.state_space",
    "models.jacobian",
    "models.additive",
    "models.scalar",
    "models.van_der_pol",
    "models.falling_body",
    "models.jump_markov",
    "models.conditionally_linear",
    "importance",
    "dimension",
    "track",
    "grid",
    "kalman",
    "unscented",
    "data",
    "filters.loop",
    "filters.bootstrap",
    "filters.optimal",
    "filters.auxiliary",
    "filters.regularized",
    "filters.local_linear",
    "filters.kalman_bank",
    "filters.rao_blackwellized",
    "particle_filter",
    "smoothing",
    "pmmh",
    "adaptive",
    "studies",
    "checks",
]
BY_REFERENCE = "Parameters, returns and errors are those of"


def public_names():
    """Functions and classes that each module defines itself, as (module.name, object)."""
    for module_name in CORE:
        module = importlib.import_module(f"pfedu.{module_name}")
        for name, thing in vars(module).items():
            is_ours = getattr(thing, "__module__", None) == module.__name__
            if not name.startswith("_") and is_ours and (inspect.isclass(thing) or inspect.isfunction(thing)):
                yield f"{module_name}.{name}", thing


PUBLIC = dict(public_names())
every_name = pytest.mark.parametrize("thing", PUBLIC.values(), ids=PUBLIC)


def section(thing, title):
    """Text of a numpydoc section, or None."""
    found = re.search(rf"^{title}\n-{{{len(title)}}}\n(.*?)(?=^\w[\w ]*\n---|\Z)", inspect.getdoc(thing), re.M | re.S)
    return found and found.group(1)


def described(text):
    """Names that a Parameters or Attributes section lists: unindented lines, `a, b : type` or `a, b`."""
    heads = re.findall(r"^(\w[\w, ]*?)(?: :.*)?$", text or "", re.M)
    return {name.strip() for head in heads for name in head.split(",")}


def by_reference(thing):
    """Whether a docstring leaves parameters and returns to that of a neighbour, in so many words."""
    return BY_REFERENCE in " ".join(thing.__doc__.split())


def is_error(thing):
    return inspect.isclass(thing) and issubclass(thing, Exception)


def test_the_walk_finds_the_package():
    """Catches a walk over nothing, after which all the tests below would pass."""
    assert {
        "weights.normalize",
        "resampling.systematic",
        "models.scalar.growth",
        "filters.loop.particle_filter",
    } <= set(PUBLIC)
    assert len(PUBLIC) > 30


@every_name
def test_has_a_summary(thing):
    """Catches a name without a word, or one that only inherits its base's docstring."""
    summary = (thing.__doc__ or "").strip().splitlines()
    assert summary and summary[0].endswith(".")


@every_name
def test_describes_its_parameters(thing):
    """Catches an argument that was added or renamed and not described."""
    if is_error(thing) or by_reference(thing):
        return
    names = {p for p in inspect.signature(thing).parameters if p != "self"}
    if names:
        told = described(section(thing, "Parameters")) | described(section(thing, "Attributes"))
        assert names <= told


@every_name
def test_describes_what_it_returns(thing):
    """Catches a function whose result the reader must guess."""
    if inspect.isclass(thing) or by_reference(thing):
        return
    body = ast.parse(textwrap.dedent(inspect.getsource(thing))).body[0]
    if any(isinstance(node, ast.Return) and node.value is not None for node in ast.walk(body)):
        assert section(thing, "Returns")


@every_name
def test_shows_an_example(thing):
    """Catches a name without an example; that examples run is the doctests' business. Errors need none."""
    if not is_error(thing):
        assert ">>>" in (section(thing, "Examples") or "")


@pytest.mark.parametrize("module", CORE)
def test_a_module_says_what_it_is_for(module):
    """Catches a room without a sign on its door."""
    assert importlib.import_module(f"pfedu.{module}").__doc__
