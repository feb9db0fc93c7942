"""Which episodes are held out: whole robots where several are labelled, else whole episodes."""

from collections.abc import Iterable, Sequence

import numpy as np

from nfpde.dataset.episode import Episode
from nfpde.errors import BadDataset, BadInput


def held_out_episodes(episodes: Sequence[Episode], held_out: float | Sequence[str], seed: int) -> list[int]:
    """Indices of the held-out episodes; neither they nor the rest are ever empty.

    Args:
        episodes: All episodes.
        held_out: Share in (0, 1) of the robots (of the episodes, where fewer than two robots are labelled),
            rounded, at least one and never all; or the names of episodes or robots.
        seed: Seed of the choice; without effect on names.

    Returns:
        Indices, increasing.

    Raises:
        BadInput: The share is outside (0, 1), or a name does not exist or could mean two things.
        BadDataset: One side would be empty.
    """
    if isinstance(held_out, str):
        raise BadInput(f"held_out is the text {held_out!r}; give a share or a list of names: [{held_out!r}].")
    if isinstance(held_out, int | float | np.number):
        chosen = _draw(episodes, float(held_out), seed)
    elif isinstance(held_out, Iterable):
        chosen = _named(episodes, held_out)
    else:
        raise BadInput(f"held_out is {held_out!r}; give a share between 0 and 1, or a list of names.")
    if len(chosen) in (0, len(episodes)):
        raise BadDataset(
            f"the split leaves {len(episodes) - len(chosen)} of {len(episodes)} episodes in and {len(chosen)} "
            "held out; both sides need at least one. Record more episodes, or name fewer."
        )
    return sorted(chosen)


def _draw(episodes: Sequence[Episode], share: float, seed: int) -> set[int]:
    if not 0 < share < 1:
        raise BadInput(f"held_out is {share}; a share must lie between 0 and 1, both excluded.")
    groups: dict[tuple[str, str], list[int]] = {}
    by_robot = len({e.robot for e in episodes if e.robot is not None}) > 1
    for i, e in enumerate(episodes):
        key = ("robot", e.robot) if by_robot and e.robot is not None else ("episode", e.name)
        groups.setdefault(key, []).append(i)
    members = list(groups.values())
    if len(members) < 2:
        return set(members[0])
    count = min(max(round(share * len(members)), 1), len(members) - 1)
    picked = np.random.default_rng(seed).permutation(len(members))[:count]
    return {i for group in picked for i in members[group]}


def _named(episodes: Sequence[Episode], names: Iterable[str]) -> set[int]:
    chosen: set[int] = set()
    for name in names:
        as_episode = {i for i, e in enumerate(episodes) if e.name == name}
        as_robot = {i for i, e in enumerate(episodes) if e.robot == name}
        if as_episode and as_robot and as_episode != as_robot:
            raise BadInput(f"held_out: {name!r} is an episode and a robot; rename one of them.")
        if not as_episode | as_robot:
            labels = [e.name for e in episodes] + sorted({e.robot for e in episodes if e.robot is not None})
            raise BadInput(f"held_out: no episode or robot is named {name!r}; there are {', '.join(labels)}.")
        chosen |= as_episode | as_robot
    return chosen
