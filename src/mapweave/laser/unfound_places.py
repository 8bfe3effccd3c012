"""A trajectory that says it passes by places seen before, where none of them is found again: told, not kept quiet."""

from .robot_graph import RobotGraph


def unfound_places(graph: RobotGraph, in_a_row: int) -> tuple[str, ...]:
    """A warning for the longest stretch of searches for old places, one after the other, that found none.

    Searches are made where the estimate says that the robot is near a place of its own that it saw long ago. A heading
    or a trajectory along a corridor that went wrong once makes all later ones fail, and no closure is there to
    contradict it. in_a_row: searches from which it is a warning, since along a right trajectory some fail too.
    """
    found: dict[int, bool] = {}
    for c in graph.closures:
        if c.robots[0] == c.robots[1]:
            found[c.second] = found.get(c.second, False) or c.accepted
    longest: list[int] = []
    run: list[int] = []
    for keyframe in sorted(found):
        run = [] if found[keyframe] else [*run, keyframe]
        longest = max(longest, run, key=len)
    if len(longest) < in_a_row:
        return ()
    first, last = graph.t[longest[0]], graph.t[longest[-1]]
    searched = f"places seen before were searched for {len(longest)} times in a row and none was found again"
    why = "the trajectory may be wrong from there on, or the place looks different now"
    return (f"from {first:.1f} s to {last:.1f} s {searched}: {why}",)
