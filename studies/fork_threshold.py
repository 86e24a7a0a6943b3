"""Measures on a finished run what FORK's threshold and max_reward should be.

python studies/fork_threshold.py RUN_FOLDER

Trains FORK's two networks on the run's replay buffer, which grows as it did in the run, and prints their losses beside
the loss of predicting that nothing changes. A threshold above that loss lets the actor look ahead with a model that
knows nothing. max_reward is the mean return of the flights that arrived in the second half of the run.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import zipfile
from pathlib import Path

import torch
from tensordict import TensorDictBase
from torch.nn.functional import mse_loss, smooth_l1_loss

from uavrl.buffers import FrameStorage
from uavrl.models import RewardNet, SystemNet
from uavrl.runs.checkpoint import latest_checkpoint
from uavrl.runs.episodes import read_episodes
from uavrl_onboard.cli.process import one_sentence

FRAME = 35


def replay_data(run: Path, folder: Path) -> TensorDictBase:
    """The transitions in the newest checkpoint of a run."""
    with zipfile.ZipFile(latest_checkpoint(run)) as archive:
        prefix = json.loads(archive.read("manifest.json"))["components"]["replay_data"]["path"]
        archive.extractall(folder, [name for name in archive.namelist() if name.startswith(prefix)])
    storage = FrameStorage.saved_at(folder / prefix / "storage")
    return storage.get(slice(0, len(storage)))


def main() -> None:
    """Reads the run named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--updates", type=int, default=20_000)
    parser.add_argument("--batch-size", type=int, default=100)
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    episodes = read_episodes(args.run / "episodes.csv")
    arrived = [e.episode_return for e in episodes[len(episodes) // 2 :] if e.outcome == "arrived"]
    print(f"mean return of {len(arrived)} arrivals: {sum(arrived) / max(len(arrived), 1):.0f}")
    with tempfile.TemporaryDirectory() as folder:
        data = replay_data(args.run, Path(folder))
    state, action, reward = data["observation"], data["action"], data["next", "reward"]
    following = data["next", "observation"]
    unchanged = torch.cat([state[:, FRAME:], state[:, -FRAME:]], -1)
    print(f"system loss of predicting no change: {smooth_l1_loss(unchanged, following):.5f}")
    system, rewards = SystemNet(state.shape[-1], 4), RewardNet(state.shape[-1], 4)
    optimizer = torch.optim.Adam([*system.parameters(), *rewards.parameters()], lr=3e-4, fused=True)
    low, high = state.amin(0), state.amax(0)
    first = min(5000, len(state))
    recent: list[tuple[float, float]] = []
    for update in range(1, args.updates + 1):
        stored = first + (len(state) - first) * update // args.updates
        row = torch.randint(stored, (args.batch_size,))
        system_loss = smooth_l1_loss(system(state[row], action[row]).clamp(low, high), following[row])
        reward_loss = mse_loss(rewards(state[row], following[row], action[row]), reward[row])
        optimizer.zero_grad()
        (system_loss + reward_loss).backward()
        optimizer.step()
        recent = [*recent[-99:], (system_loss.item(), reward_loss.item())]
        if update in (100, 300, 1000) or update % max(args.updates // 10, 1) == 0:
            means = torch.tensor(recent).mean(0).tolist()
            print(f"{update:>7,} updates: system loss {means[0]:.5f}, reward loss {means[1]:.1f}")


if __name__ == "__main__":
    with one_sentence():
        main()
