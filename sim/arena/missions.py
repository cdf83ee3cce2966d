"""Random missions over everything that a mission may have: the material of a property test and of a benchmark.

Each is drawn by one of several recipes of the families of the field (`sim.arena.families.field`): single agents and
fleets, threats that stand and that move, state frames and packed ones, links that lose nothing or nearly all. A mission
depends on its seed and index alone.
"""

from __future__ import annotations

from dataclasses import dataclass

from companion.errors import InputError
from companion.mission.model import Mission
from companion.mission.random_streams import random_stream
from companion.mission.resolve import check_start
from groundstation.radio import Radio, parse_radio
from sim.arena.families.drawing import TRIES, NoRoomError
from sim.arena.families.field import LOSSES, Recipe, drawn

MISSIONS_STREAM = 12
"""Number of the random stream, among those of the seed, that random missions are drawn from."""
PACKED_SHARE = 0.25
"""Share of the missions whose broadcast goes, packed, over a radio of a declared rate."""
RADIO_BYTES_PER_S = (1_500, 20_000)
"""Rates of those radios."""

_LINKS = tuple(LOSSES)
_CALM = ("open", "scattered", "mixed", "fence", "ring")
RECIPES: dict[str, tuple[float, Recipe]] = {
    "static": (0.5, Recipe()),
    "lossy": (0.15, Recipe(links=_LINKS)),
    "moving": (0.12, Recipe(scenes=_CALM, movers=(1, 8), links=("clear", "clear", *_LINKS))),
    "chased": (0.05, Recipe(scenes=("open", "scattered", "fence"), movers=(1, 4), motions=("chase",))),
    "fleet": (0.1, Recipe(scenes=("open", "scattered", "lattice", "wall", "fence"), agents=(2, 8))),
    "moving fleet": (0.08, Recipe(scenes=_CALM, agents=(2, 6), movers=(0, 4), shares=(0.05, 0.5), links=_LINKS)),
}
"""Recipes of the random missions by name, each with its share of them."""


@dataclass(frozen=True)
class RandomMission:
    """A random mission, how its broadcast travels, and the seed that it is flown with."""

    mission: Mission
    recipe: str
    radio: Radio | None
    """Radio over which the broadcast goes packed; None: it goes as state frames."""
    seed: int

    @property
    def call(self) -> str:
        """The call that flies the mission from its file again."""
        radio = "" if self.radio is None else f" --radio '{self.radio.bytes_per_s:g}'"
        return f"sim fly {self.mission.name}.yaml --seed {self.seed}{radio}"


def random_mission(seed: int, index: int, small: bool = False) -> RandomMission:
    """Return mission `index` of a seed, resolved, its start legal; a `small` one is flown in a fraction of a second.

    Raises RuntimeError if no scene was found within TRIES draws.
    """
    generator = random_stream(seed, MISSIONS_STREAM, index)
    names = list(RECIPES)
    name = str(generator.choice(names, p=[RECIPES[each][0] for each in names]))
    packed = bool(generator.random() < PACKED_SHARE)
    radio = parse_radio(str(int(generator.integers(*RADIO_BYTES_PER_S))), 1.0) if packed else None
    recipe = RECIPES[name][1].small() if small else RECIPES[name][1]
    title = f"{name.replace(' ', '-')}-{seed}-{index}"
    for _ in range(TRIES):
        try:
            mission = drawn(generator, title, recipe)
            check_start(mission, mission.name)
        except (NoRoomError, InputError):
            continue
        return RandomMission(mission, name, radio, int(generator.integers(2**31)))
    raise RuntimeError(f"{title}: no scene in {TRIES} draws")
