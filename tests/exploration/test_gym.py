"""The environment for researchers: PettingZoo's own test, and planners that act through it."""

import re
from pathlib import Path

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from mapweave.exploration.gym import ExplorationEnv
from mapweave.exploration.landmarks.config import ExploreConfig, MissionConfig


def test_the_environment_passes_pettingzoos_api_test():
    parallel_api_test(ExplorationEnv(cfg=ExploreConfig(mission=MissionConfig(max_steps=40))), num_cycles=60)


def test_the_same_seed_gives_the_same_environment():
    parallel_seed_test(lambda: ExplorationEnv(cfg=ExploreConfig(mission=MissionConfig(max_steps=15))), num_cycles=10)


@pytest.mark.parametrize("name", ["random", pytest.param("coverage", marks=pytest.mark.slow)])
def test_an_episode_runs_to_its_end_with_rewards_for_new_ground(name):
    env = ExplorationEnv("yuan", robots=3, until=25)
    seen, _ = env.reset(seed=4)
    rng = np.random.default_rng(0)
    total = dict.fromkeys(env.agents, 0.0)
    steps = 0
    while env.agents:
        random = {a: int(rng.integers(env.action_space(a).n)) for a in env.agents}
        actions = random if name == "random" else env.planner_actions(name)
        seen, rewards, ended, cut, _ = env.step(actions)
        steps += 1
        for agent, reward in rewards.items():
            total[agent] += reward
    assert steps == 25
    assert all(ended.values())
    assert not any(cut.values())
    assert all(o.shape == (204,) and np.isfinite(o).all() for o in seen.values())
    assert sum(total.values()) > 10


@pytest.mark.slow
def test_a_planner_sees_more_ground_than_chance():
    def explored(name):
        env = ExplorationEnv(robots=2, until=40)
        env.reset(seed=1)
        rng = np.random.default_rng(0)
        while env.agents:
            chance = {a: int(rng.integers(36)) for a in env.agents}
            env.step(chance if name == "random" else env.planner_actions(name))
        return env.team.explored.team().mean()

    assert explored("coverage") > 1.3 * explored("random")


@pytest.mark.slow
def test_the_example_in_the_documentation_runs(capsys):
    page = Path(__file__).parents[2] / "docs" / "methods" / "active-exploration.md"
    blocks = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    (code,) = (b for b in blocks if "ExplorationEnv" in b)
    exec(compile(code, str(page), "exec"), {})  # noqa: S102
    random, coverage = (float(line.split(": ")[1]) for line in capsys.readouterr().out.splitlines())
    assert coverage > random
