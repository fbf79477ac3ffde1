"""What the reference of the package asks of Sphinx beyond its own extensions.

Each thing has one entry, in the module that defines it; every other name that it goes by leads there.
"""

import inspect
import pkgutil
from dataclasses import dataclass
from importlib import import_module

from numpydoc.xref import DEFAULT_LINKS
from sphinx.ext.autosummary import Autosummary

import pfedu

UPPER_FLOORS = {"explorers", "figures", "live"}


def setup(app):
    """Connect the extension to Sphinx."""
    app.add_directive("modules", Modules)
    app.connect("config-inited", _sort_and_link, priority=400)  # before numpydoc reads its settings
    app.connect("autodoc-process-signature", _name_bases_that_say_something)
    app.connect("missing-reference", _lead_to_where_it_is_defined)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


class Modules(Autosummary):
    """A table of modules, each with its first sentence; also of one whose package has a function of the same name."""

    def import_by_name(self, name, prefixes):
        """Import a module, where autosummary would take an attribute of its package first."""
        return name, import_module(name), None, name


@dataclass(frozen=True)
class Order:
    """The order of kinds; a value and not a function, so that the next build sees that nothing has changed."""

    kinds: tuple

    def __call__(self, kind):
        """Tell the place of a kind."""
        return self.kinds.index(kind)


def _sort_and_link(app, config):
    """Functions stand first in the tables; in the types of parameters the package's own classes are links."""
    config.autodocsumm_section_sorter = Order(("Functions", "Classes", "Exceptions", "Data"))
    config.numpydoc_xref_ignore = "all"
    config.numpydoc_xref_aliases = {word: word for word in DEFAULT_LINKS}  # those lead to other sites
    for info in pkgutil.walk_packages(pfedu.__path__, "pfedu."):
        if info.name.split(".")[1] not in UPPER_FLOORS:
            for name, thing in vars(import_module(info.name)).items():
                if inspect.isclass(thing) and thing.__module__ == info.name and not name.startswith("_"):
                    config.numpydoc_xref_aliases[name] = f"{info.name}.{name}"


def _name_bases_that_say_something(app, what, name, thing, options, signature, returns):
    if inspect.isclass(thing):
        options["show-inheritance"] = thing.__bases__ != (object,)


def _lead_to_where_it_is_defined(app, env, node, contnode):
    """An entry for a name that another module passes on: `pfedu.Track` is `pfedu.track.Track`."""
    if node.get("refdomain") != "py":
        return None
    target, python = node["reftarget"], env.get_domain("py")
    for name in (target, f"{node.get('py:module')}.{target}"):
        if (defined := _defined(name)) in python.objects:
            return python.resolve_xref(env, node["refdoc"], app.builder, node["reftype"], defined, node, contnode)
    return None


def _defined(name):
    """Full name of a thing where it is defined, or None; of a method or property, that of its class and its own."""
    home, _, last = name.rpartition(".")
    if not home:
        return None
    try:
        thing = getattr(import_module(home), last)
    except ModuleNotFoundError:
        owner = _defined(home)
        return owner and f"{owner}.{last}"
    except (AttributeError, ValueError):
        return None
    return f"{getattr(thing, '__module__', None)}.{getattr(thing, '__qualname__', None)}"
