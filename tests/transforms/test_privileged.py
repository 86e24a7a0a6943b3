"""One entry of what critics alone read."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from tests.helpers.contracts import TransformContract
from tests.helpers.small_env import SmallEnv
from uavrl.transforms import Mirror, Privileged, mirror_observation


class TestPrivileged(TransformContract):
    def make_transform(self) -> Privileged:
        return Privileged(["distance", "faces"], {"distance": 5.0})

    @staticmethod
    def make_env() -> SmallEnv:
        return SmallEnv()

    def make_data(self, *batch: int) -> TensorDict:
        generator = torch.Generator().manual_seed(0)
        drawn = {key: torch.rand(*batch, width, generator=generator) for key, width in (("distance", 1), ("faces", 32))}
        return TensorDict(drawn, batch)

    def test_the_quantities_stand_end_to_end_each_divided_by_its_own_number(self) -> None:
        data = self.make_data(4)
        told = self.make_transform()(data.clone())["privileged"]
        assert torch.equal(told, torch.cat([data["distance"] / 5.0, data["faces"]], -1))


def test_a_mirror_turns_what_critics_read_with_what_policies_read() -> None:
    torch.manual_seed(0)
    wind = torch.tensor([1.0, 2.0, 3.0]).expand(40, 3)
    seen = torch.rand(40, 35)
    after = {"observation": seen, "privileged": wind}
    data = TensorDict({"observation": seen, "action": torch.ones(40, 4), "privileged": wind, "next": after}, [40])
    signs = dict.fromkeys(("privileged", ("next", "privileged")), (1.0, -1.0, 1.0))
    read = Mirror(signed=signs)(data)
    changed = read["action"][:, 1] < 0
    assert 8 < changed.sum() < 32
    assert torch.equal(read["observation"][changed], mirror_observation(seen[changed]))
    for key in signs:
        assert torch.equal(read[key], torch.where(changed[:, None], wind * torch.tensor([1.0, -1.0, 1.0]), wind))
