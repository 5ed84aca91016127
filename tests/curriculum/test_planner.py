"""Shortest paths, against a search without tensors."""

from collections import deque

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from splatrl.collision import NoChecker
from splatrl.curriculum import UNREACHABLE, plan
from splatrl.curriculum.field import FAR
from splatrl.envs.stateful_env import StatefulEnv
from splatrl.envs.tasks import Grid, Outcome
from splatrl.envs.transforms import FrameSkip
from splatrl.motions import LatticeMotion
from tests.curriculum.graph import successors
from tests.tiny import BODY, BlockChecker, tiny_env, tiny_plan, tiny_task

State = tuple[int, ...]


class FenceChecker(BlockChecker):
    """Blocks every crossing of the line x = 0.25, though every pose is free."""

    def collides(self, body_to_world: Tensor) -> Tensor:
        return torch.zeros(len(body_to_world), dtype=torch.bool)

    def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
        crosses = (start[:, 0, 3] < 0.25) != (end[:, 0, 3] < 0.25)
        return torch.where(crosses, 0.5, 1.0)


def brute_force(motion: LatticeMotion, checker: BlockChecker, task: Grid) -> dict[State, int]:
    """Count the steps to the goal from every state, by breadth-first search with a queue, one state at a time."""

    def neighbours(state: State) -> list[State]:
        found = []
        for dx, dy, dyaw in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)):
            ahead = (state[0] + dx, state[1] + dy, (state[2] + dyaw) % motion.shape[2])
            if not (0 <= ahead[0] < motion.shape[0] and 0 <= ahead[1] < motion.shape[1]):
                continue
            poses = motion.body_to_world(torch.tensor([state, ahead]))
            if not checker.collides(poses).any() and not checker.sweeps(poses[:1], poses[1:]).any():
                found.append(ahead)
        return found

    steps, states = {}, motion.states()
    goals = set(map(tuple, states[task.reached(states)].tolist()))
    moves = {tuple(state): neighbours(tuple(state)) for state in states.tolist()}
    for start in moves:
        if checker.collides(motion.body_to_world(torch.tensor([start]))).any():
            continue
        queue, seen = deque([(start, 0)]), {start}
        while queue:
            state, depth = queue.popleft()
            if state in goals:
                steps[start] = depth
                break
            for ahead in moves[state]:
                if ahead not in seen:
                    seen.add(ahead)
                    queue.append((ahead, depth + 1))
    return steps


@pytest.mark.parametrize("checker", [BlockChecker(), FenceChecker(), BlockChecker(reach=0.6)])
def test_distances_match_a_plain_breadth_first_search(checker: BlockChecker) -> None:
    motion = LatticeMotion(0.5, 0.5, 90.0, (-1.0, -1.5), (1.0, 1.5))
    task = Grid(motion, goal=(0.75, 1.0, 0.0))
    found = plan(motion, checker, task.reached)
    expected = brute_force(motion, checker, task)
    assert {
        tuple(s): d for s, d in zip(found.states.tolist(), found.distance.tolist(), strict=True) if d >= 0
    } == expected
    assert set(found.distance[[tuple(s) not in expected for s in found.states.tolist()]].tolist()) <= {UNREACHABLE}


def test_descending_the_distances_reaches_the_goal_in_the_planned_number_of_steps() -> None:
    found = tiny_plan()
    rows, steps = found.start_rows, 0
    left = found.distance[rows]
    while (left > 0).any():
        choices = successors(found)[rows]
        cost = torch.where(choices == UNREACHABLE, 10**6, found.distance[choices])
        rows = torch.where(left > 0, choices.gather(1, cost.argmin(1, keepdim=True)).squeeze(1), rows)
        assert torch.equal(found.distance[rows], (left - 1).clamp_min(0))
        left, steps = found.distance[rows], steps + 1
    assert steps == found.distance.max() == 9


def test_the_start_set_is_every_free_state_with_a_path_to_the_goal_except_goal_states() -> None:
    found = tiny_plan()
    assert len(found.states) == 280 and found.free.sum() == 280 - 8  # the block fills one position
    assert len(found.start_rows) == 280 - 8 - 27
    assert found.free[found.start_rows].all()
    assert not tiny_task().reached(found.states[found.start_rows]).any()


def test_no_action_leads_out_of_the_lattice_or_into_the_block() -> None:
    found = tiny_plan()
    corner = (found.states == torch.tensor([0, 0, 0])).all(1).nonzero().item()
    assert [int(row) == UNREACHABLE for row in successors(found)[corner]] == [False, True, False, True, False, False]
    beside = (found.states == torch.tensor([1, 3, 0])).all(1).nonzero().item()
    assert successors(found)[beside, 0] == UNREACHABLE
    assert (successors(found)[~found.free] == UNREACHABLE).all()


def test_starts_behind_a_fence_are_left_out() -> None:
    task = tiny_task()
    found = plan(task.motion, FenceChecker(), task.reached)
    assert found.free.all()
    reachable = found.distance != UNREACHABLE
    # x = 0 lies within the goal's tolerance, so there are goal poses on both sides of the fence
    assert reachable.all()
    east = Grid(task.motion, goal=(1.0, 1.0, 0.0))
    found = plan(task.motion, FenceChecker(), east.reached)
    assert torch.equal(found.distance != UNREACHABLE, found.states[:, 0] >= 3)


def test_a_scene_without_a_free_pose_is_refused() -> None:
    task = tiny_task()
    with pytest.raises(ValueError, match="scene: expected free poses, got 280 poses that all collide"):
        plan(task.motion, BlockChecker(reach=10.0), task.reached)


def test_a_goal_inside_an_obstacle_is_refused() -> None:
    motion = LatticeMotion(0.5, 0.5, 45.0, (-1.0, -1.5), (1.0, 1.5))
    task = Grid(motion, goal=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"task: expected a free pose at the goal, found none among 27 poses there"):
        plan(motion, BlockChecker(reach=0.6), task.reached)


def test_a_goal_outside_the_lattice_is_refused() -> None:
    motion = tiny_task().motion
    with pytest.raises(ValueError, match=r"task: expected a free pose at the goal"):
        plan(motion, BlockChecker(), Grid(motion, goal=(5.0, 0.0, 0.0)).reached)


def test_a_goal_without_a_path_to_it_is_refused() -> None:
    class Frozen(FenceChecker):
        def free_fraction(self, start: Tensor, end: Tensor) -> Tensor:
            return torch.zeros(len(start))

    task = tiny_task()
    with pytest.raises(
        ValueError, match=r"task: expected a path to the goal from at least one free pose, found none from 280"
    ):
        plan(task.motion, Frozen(), task.reached)


def test_optimal_actions_are_those_that_lead_one_step_nearer() -> None:
    found = tiny_plan()
    choices, distance = successors(found), found.distance
    after = torch.where(choices == UNREACHABLE, 10**6, distance[choices])
    expected = (after == distance.unsqueeze(1) - 1) & (distance > 0).unsqueeze(1)
    best = found.optimal(found.states[found.free])
    assert torch.equal(best, expected[found.free])
    assert (best.sum(1) > 1).any() and (best.sum(1) == 1).any()


def test_optimal_actions_match_those_worked_out_by_hand() -> None:
    best = tiny_plan().optimal(torch.tensor([[1, 5, 0], [0, 5, 2], [1, 3, 0], [3, 5, 0]]))
    yes = [row.nonzero().flatten().tolist() for row in best]
    assert yes == [[0], [0, 5], [2], []]  # +x; +x or turn right; round the block by +y; at the goal


def test_no_action_is_optimal_where_there_is_no_path() -> None:
    task = tiny_task()
    found = plan(task.motion, FenceChecker(), Grid(task.motion, goal=(1.0, 1.0, 0.0)).reached)
    west = found.states[found.states[:, 0] < 3]
    assert not found.optimal(west).any() and (found.cost_to_go(west) == FAR).all()


def test_the_cost_to_go_equals_the_distances() -> None:
    found = tiny_plan()
    rows = found.distance >= 0
    assert torch.equal(found.cost_to_go(found.states[rows]), found.distance[rows].float())


@pytest.mark.parametrize("farthest", [1, 4, 9, 50])
def test_the_start_set_can_be_limited_to_a_longest_path(farthest: int) -> None:
    task = tiny_task()
    cut, whole = plan(task.motion, BlockChecker(), task.reached, farthest), tiny_plan()
    assert torch.equal(cut.distance, whole.distance)  # the field still covers every state
    assert torch.equal(cut.start_rows, ((whole.distance > 0) & (whole.distance <= farthest)).nonzero().squeeze(1))
    assert (len(cut.start_rows) < len(whole.start_rows)) is (farthest < 9)


def test_an_empty_start_set_is_refused() -> None:
    task = tiny_task()
    with pytest.raises(
        ValueError, match=r"task: expected a path to the goal from at least one free pose, found none from 272"
    ):
        plan(task.motion, BlockChecker(), task.reached, farthest=0)


def test_robots_that_pass_through_everything_start_everywhere_and_go_straight() -> None:
    task = tiny_task()
    found = plan(task.motion, NoChecker(None, BODY), task.reached)
    assert found.free.all() and len(found.start_rows) == 280 - 27
    x, y, spin = (found.states - torch.tensor([3, 5, 0])).abs().unbind(1)
    spin = torch.minimum(spin, 8 - spin)
    expected = sum((axis - 1).clamp_min(0) for axis in (x, y, spin))
    assert torch.equal(found.distance, expected)


@pytest.mark.parametrize("repeats", [2, 3])
def test_paths_of_repeated_actions_match_a_search_over_the_steps_of_an_env(repeats: int) -> None:
    task = tiny_task()
    found = plan(task.motion, BlockChecker(), task.reached, repeats=repeats)
    states, actions = found.states, len(found.actions)
    env = StatefulEnv(tiny_env((len(states),), max_steps=50), FrameSkip(repeats))
    ends = torch.zeros(len(states), actions)
    leads_to = torch.zeros(len(states), actions, dtype=torch.int64)
    taken = torch.zeros(len(states), actions)
    for action in range(actions):
        given = env.reset(TensorDict({"state": states.clone()}, [len(states)]), set_state=True)
        after = env.step(given.set("action", torch.full((len(states),), action)))["next"]
        outcome = after["outcome"].squeeze(1)
        ends[:, action] = torch.where(outcome == Outcome.GOAL, 0.0, torch.where(outcome > 0, FAR, torch.nan))
        leads_to[:, action] = task.motion.index(after["state"])
        taken[:, action] = after["step_count"].squeeze(1)
    steps = torch.full((len(states),), FAR)
    for _ in range(len(states)):
        after = torch.where(ends.isnan(), steps[leads_to], ends) + taken
        steps = torch.minimum(steps, after.amin(1))
    starts, unsolvable = found.start_rows, (steps >= FAR) & found.free
    assert torch.equal(found.distance[starts].float(), steps[starts])
    assert (found.distance[unsolvable] == UNREACHABLE).all() and (repeats == 2 or unsolvable.any())
    best = after[starts] == steps[starts].unsqueeze(1)
    assert torch.equal(found.optimal(states[starts]), best) and not best.all()
    near = plan(task.motion, BlockChecker(), task.reached, farthest=5, repeats=repeats).start_rows
    assert torch.equal(near, starts[steps[starts] <= 5]) and len(near) < len(starts)
