"""The exploration as a PettingZoo parallel environment (extra `[gym]`): one agent a robot, rewards for new ground.

Observation of an agent, (12 + 16 x 12,) float32 in [-1, 1]:
- pose in the map: x and y over the half field, cos and sin of the heading; sd of x and y over the reach, of the
  heading over pi (cut at 1); steps in the current submap over `fuse_by`; landmarks in it over 50; explored share;
  distance to the nearest other live robot over the field's diagonal (1 when alone); 1 when alive, else 0;
- what the team has seen, as this robot knows it: the field in 16 x 12 blocks, each its seen share, rows from low y.
Action: one of the 36 controls of `ExploreConfig.controls` by its number. One that would leave the field, or come too
near to a wall, is replaced by the offered one closest to it.
Reward: the share of the field newly seen by the agent in this step, times 100, minus 0.1; plus 10 for each robot when
the goal is reached.
A dead robot's agent terminates; all terminate when the goal is reached and are truncated after `max_steps`.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ..core.errors import UsageError
from ..fusion.handover import pose_in_map
from .landmarks.belief import Planner
from .landmarks.config import ExploreConfig, find_scenario, make_field
from .landmarks.objective import offered
from .landmarks.team import Team
from .planner_interface import find_planner

try:
    from gymnasium import spaces
    from pettingzoo import ParallelEnv
except ImportError:
    raise UsageError("the exploration environment needs PettingZoo: install mapweave with the extra [gym]") from None

BLOCKS = (12, 16)  # rows, columns


class ExplorationEnv(ParallelEnv):  # type: ignore[misc]
    """A scenario explored by a team, one control a robot and step."""

    metadata = {"name": "mapweave_exploration_v0", "render_modes": []}  # noqa: RUF012  (PettingZoo's own form)
    render_mode = None

    def __init__(
        self,
        scenario: str = "yuan",
        robots: int = 2,
        until: str | int = "landmarks",
        cfg: ExploreConfig | None = None,
    ) -> None:
        self.scenario, self.until, self.cfg = find_scenario(scenario), until, cfg or ExploreConfig()
        self.robots = robots
        self.possible_agents = [f"robot{k + 1}" for k in range(robots)]
        self.agents: list[str] = []
        size = 12 + BLOCKS[0] * BLOCKS[1]
        self._observation = spaces.Box(-1.0, 1.0, (size,), np.float32)
        self._actions = {name: spaces.Discrete(len(self.cfg.controls)) for name in self.possible_agents}
        self.team: Team | None = None
        self._seed = 0

    def observation_space(self, agent: str) -> Any:
        del agent
        return self._observation

    def action_space(self, agent: str) -> Any:
        return self._actions[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, dict]]:
        """A new layout and new noise, both from `seed`; without one, the next after the last."""
        del options
        self._seed = self._seed + 1 if seed is None else seed
        world = make_field(self.scenario, self.robots, self._seed)
        self.team = Team(world, self.cfg, self._commanded, np.random.default_rng([self._seed, 1]), until=self.until)
        self.team.observe_start()
        self._play = self.team.play()
        self.agents = list(self.possible_agents)
        return self._observe(), {name: {} for name in self.agents}

    def step(
        self, actions: Mapping[str, int | np.integer]
    ) -> tuple[dict[str, np.ndarray], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict]]:
        """All robots drive, see, map and hand over; PettingZoo's five dictionaries."""
        team = self.team
        if team is None or not self.agents:
            return {}, {}, {}, {}, {}
        self._chosen = self._commands(team, actions)
        before = [int(team.explored.known_to(j).sum()) for j in range(self.robots)]
        moment = next(self._play, None)
        done = moment is None or team.reached()
        if done:
            next(self._play, None)  # the submaps left are handed over
        over = not done and team.step >= self.cfg.mission.max_steps
        cells = team.explored.fused.size
        rewards, live = {}, team.alive
        for name in self.agents:
            j = self.possible_agents.index(name)
            new = max(0, int(team.explored.known_to(j).sum()) - before[j])
            rewards[name] = 100.0 * new / cells - 0.1 + (10.0 if done else 0.0)
        ended = {name: bool(done or not live[self.possible_agents.index(name)]) for name in self.agents}
        cut = dict.fromkeys(self.agents, bool(over))
        seen, infos = self._observe(), {name: {"step": team.step} for name in self.agents}
        self.agents = [name for name in self.agents if not (ended[name] or cut[name])]
        return seen, rewards, ended, cut, infos

    def planner_actions(self, planner: str | Planner) -> dict[str, int]:
        """What a planner would do now, as actions: the controls nearest to its commands."""
        if self.team is None:
            raise UsageError("reset the environment before asking a planner")
        choose = find_planner(planner, "landmarks") if isinstance(planner, str) else planner
        commands = choose(self.team.belief(), self.team.poses(), self.cfg)
        controls = self.cfg.controls
        return {
            name: int(np.argmin(np.abs(controls - commands[self.possible_agents.index(name)]).sum(axis=1)))
            for name in self.agents
        }

    def _commanded(self, belief: Any, poses: np.ndarray, cfg: ExploreConfig) -> np.ndarray:
        del belief, poses, cfg
        return self._chosen

    def _commands(self, team: Team, actions: Mapping[str, int | np.integer]) -> np.ndarray:
        out = np.zeros((self.robots, 2))
        belief, poses, controls = team.belief(), team.poses(), self.cfg.controls
        for name, action in actions.items():
            j = self.possible_agents.index(name)
            allowed, _ = offered(belief, poses[j], self.cfg)
            out[j] = allowed[np.argmin(np.abs(allowed - controls[int(action)]).sum(axis=1))]
        return out

    def _observe(self) -> dict[str, np.ndarray]:
        assert self.team is not None  # noqa: S101
        poses = self.team.poses()
        return {name: self._seen_by(self.team, self.possible_agents.index(name), poses) for name in self.agents}

    def _seen_by(self, team: Team, j: int, poses: np.ndarray) -> np.ndarray:
        world, sub = team.world, team.submaps[j]
        half = 0.5 * (world.upper - world.lower)
        x, y = (poses[j, :2] - world.lower - half) / half
        sd = np.sqrt(np.maximum(np.diag(pose_in_map(team.G, sub)[1]), 0.0))
        others = [i for i in np.flatnonzero(team.alive) if i != j]
        gap = min((float(np.hypot(*(poses[i, :2] - poses[j, :2]))) for i in others), default=np.inf)
        reach = self.cfg.submap.reach
        known = team.explored.known_to(j)
        own = [
            x,
            y,
            np.cos(poses[j, 2]),
            np.sin(poses[j, 2]),
            sd[0] / reach,
            sd[1] / reach,
            sd[2] / np.pi,
            team.ages[j] / self.cfg.handover.by,
            len(sub.ids) / 50,
            known.mean(),
            min(1.0, gap / float(2 * np.hypot(*half))),
            float(team.alive[j]),
        ]
        blocks = [
            b.mean() for rows in np.array_split(known, BLOCKS[0]) for b in np.array_split(rows, BLOCKS[1], axis=1)
        ]
        return np.clip(np.array([*own, *blocks], dtype=np.float32), -1.0, 1.0)
