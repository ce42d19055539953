"""The networks by name: one file each, one line here. Listing them needs no torch; `network_class` does."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from ...errors import InputError, nearest_names

if TYPE_CHECKING:
    from .network import Network

# name -> "module:Class"; a module that begins with a dot is in this package.
NETWORKS: dict[str, str] = {
    "xmae": ".xmae:XMAE",
    "convae": ".convae:ConvAE",
    "holden": ".holden:Holden",
    "trajevae": ".trajevae:TrajeVAE",
    "infilling": ".infilling:Infilling",
    "mend": ".mend:Mend",
    "cvae-rnn": ".cvae_rnn:CVAERNN",
}


def network_class(name: str) -> type[Network]:
    """The class of a registered network, or of one's own as `package.module:Class`.

    InputError where there is no such network, torch is not installed, or the class is not a Network.
    """
    address = NETWORKS.get(name, name)
    if ":" not in address:
        hint = nearest_names(name, NETWORKS) if NETWORKS else ""
        raise InputError(f"no network is named {name!r}", expected="a name, or package.module:Class", hint=hint)
    module, _, attribute = address.partition(":")
    try:
        base = importlib.import_module(".network", __name__).Network
    except ModuleNotFoundError as error:
        raise InputError(f"networks need {error.name}", hint='say: pip install "motionmend[train]"') from None
    try:
        found = getattr(importlib.import_module(module, __name__), attribute)
    except ModuleNotFoundError as error:
        if error.name is None or not module.startswith(error.name):
            raise  # the module is there, what it imports is not
        hint = f"say {module[:-3]}:{attribute}" if module.endswith(".py") else "is its folder on PYTHONPATH?"
        raise InputError(f"no module {error.name!r}", where=name, hint=hint) from None
    except AttributeError:
        raise InputError(f"the module has no {attribute!r}", where=name) from None
    if not (isinstance(found, type) and issubclass(found, base)):
        raise InputError("this is not a network", where=name, expected="a motionmend.networks.models.network.Network")
    return found
