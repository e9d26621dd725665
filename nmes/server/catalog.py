"""The worlds that a host offers, live or not: their names, configs and makers, and how many there may be.

Hides templates, limits, and how a list is cut into pages. It knows no live world.

Invariant: a world has a number of its own, higher than those of all before it. So pages of a list hold nothing twice
and leave nothing out, whatever is created and closed between them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from itertools import islice
from typing import Any, Final, NamedTuple

from nmes.errors import WorldError
from nmes.protocol import complete_config
from nmes.schemas.documents import JsonObject, did_you_mean

__all__ = ["DEFAULT", "PAGE", "Catalog", "Offer"]

DEFAULT: Final = "default"
"""The template of worlds for which none is named."""
PAGE: Final = 1000
"""How many worlds a page of the list holds."""


class Offer(NamedTuple):
    """A world that is offered.

    Attributes:
        name: Its name.
        config: Its complete config.
        number: Its place in the list.
        maker: Who created it over the wire; None: the host.
    """

    name: str
    config: JsonObject
    number: int
    maker: str | None


class Catalog:
    """The worlds of a host by name, in the order in which they were added.

    Args:
        templates: Configs of worlds that are created over the wire, by name; `default` is that of those for which none
            is named, and empty if it is not there.
        most: How many worlds there may be.
        most_each: How many of them one maker may have.
    """

    def __init__(
        self, templates: Mapping[str, Mapping[str, Any]] | None = None, most: int = 10_000, most_each: int = 100
    ) -> None:
        self._templates = {DEFAULT: {}, **(templates or {})}
        self._most, self._most_each = most, most_each
        self._offers: dict[str, Offer] = {}
        self._made: Counter[str] = Counter()
        self._next = 1

    def __contains__(self, name: str) -> bool:
        return name in self._offers

    def __getitem__(self, name: str) -> Offer:
        return self._offers[name]

    def __len__(self) -> int:
        return len(self._offers)

    @property
    def first(self) -> str | None:
        """The name of the first world; None: there is none."""
        return next(iter(self._offers), None)

    @property
    def engines(self) -> list[str]:
        """The engines of its worlds, and of those that may be created."""
        made = (complete_config({**template, "name": "any"}) for template in self._templates.values())
        return sorted({config["backend"] for config in (*made, *(offer.config for offer in self._offers.values()))})

    def config(self, name: str, template: str, seed: int | None) -> JsonObject:
        """Returns the config of a world of this name that is to be created from a template.

        Raises:
            WorldError: `world_exists`, `template_not_found`.
        """
        if name in self._offers:
            raise WorldError("world_exists", f"this host has a world {name!r} already", "create/world")
        if template not in self._templates:
            guess = did_you_mean(template, self._templates)
            raise WorldError("template_not_found", f"this host has no template {template!r}{guess}", "create/template")
        return {**self._templates[template], "name": name, **({} if seed is None else {"seed": seed})}

    def add(self, config: Mapping[str, Any], maker: str | None = None, *, new: bool = True) -> Offer:
        """Adds a world.

        Args:
            config: Its config.
            maker: Who created it over the wire; None: the host.
            new: Whether it is created now, for which its maker must not have too many.

        Raises:
            RejectedMessage: The config is not valid.
            WorldError: There is one of that name (`world_exists`), or as many as there may be (`limit_reached`).
        """
        complete = complete_config(config)
        name: str = complete["name"]
        if name in self._offers:
            raise WorldError("world_exists", f"two worlds are called {name!r}", "name")
        if len(self._offers) >= self._most:
            raise WorldError(
                "limit_reached", f"this host has {self._most:,} worlds, as many as it may: close some first"
            )
        if new and maker is not None and self._made[maker] >= self._most_each:
            message = f"{maker} has {self._most_each:,} worlds here, as many as one maker may: close some first"
            raise WorldError("limit_reached", message)
        offer = self._offers[name] = Offer(name, complete, self._next, maker)
        self._next += 1
        if maker is not None:
            self._made[maker] += 1
        return offer

    def remove(self, name: str) -> None:
        """Forgets a world."""
        maker = self._offers.pop(name).maker
        if maker is not None:
            self._made[maker] -= 1

    def page(self, start: int, only: Collection[str] | None = None) -> tuple[list[Offer], int | None]:
        """Returns the worlds with numbers from `start` on, of all if not of some, and where the next page starts.

        There is none behind the last page: its next is None.
        """
        found = list(islice(self._from(start, only), PAGE + 1))
        return found[:PAGE], found[PAGE].number if len(found) > PAGE else None

    def _from(self, start: int, only: Collection[str] | None) -> Iterator[Offer]:
        if only is not None and len(only) < len(self._offers):
            some = sorted((self._offers[name] for name in only), key=lambda offer: offer.number)
        else:
            some = list(self._offers.values())
        return (offer for offer in some if offer.number >= start)
