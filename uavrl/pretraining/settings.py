"""Settings of ``uavrl-pretrain``. Meanings and units stand in the yaml."""

from dataclasses import dataclass, field

from uavrl.config.settings import MatmulChoice, Threads
from uavrl_onboard.ranges import Count, Folder, Fraction, Positive, Seed, Widths
from uavrl_onboard.sentences import require

THESIS_CLUSTERS = (100, 250, 500, 750, 1000, *range(1500, 6001, 500))


@dataclass
class PretrainRecipe:
    """conf/pretrain: how much of everything."""

    name: str = "full"
    states: Count = 200_000
    features: Count = 20
    hidden: Count = 64
    tradeoff: Fraction = 0.7
    psae_epochs: Count = 60
    psae_batch_size: Count = 256
    psae_lr: Positive = 1e-3
    clusters: tuple[int, ...] = THESIS_CLUSTERS
    k: int | None = None
    kmeans_batch_size: Count = 4096
    kmeans_iterations: Count = 30
    classifier_hidden: Widths = (64,)
    classifier_epochs: Count = 40
    classifier_batch_size: Count = 512
    classifier_lr: Positive = 3e-3
    held_out: float = 0.1
    compare_k: int | None = 4000
    one_shot: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(0 < self.held_out < 1, "pretrain.held_out", "in (0, 1)", self.held_out)
        ks = list(self.clusters)
        ascending = ks == sorted(set(ks)) and min(ks, default=2) >= 2
        require(ascending, "pretrain.clusters", "ascending numbers of clusters from 2", ks)
        enough = self.k is not None or len(ks) >= 5
        require(enough, "pretrain.clusters", "five or more numbers of clusters, to find the elbow among", ks)
        for key in ("k", "compare_k"):
            value = getattr(self, key)
            require(value is None or value >= 2, f"pretrain.{key}", "null or at least 2", value)

    @property
    def largest_k(self) -> int:
        """The largest number of clusters that is asked for."""
        return max(*self.clusters, self.k or 0, self.compare_k or 0, 0)


@dataclass
class PretrainConfig:
    """conf/pretrain.yaml: one pre-training."""

    run: Folder | None = None
    output: Folder | None = None
    pretrain: PretrainRecipe = field(default_factory=PretrainRecipe)
    seed: Seed = 0
    threads: Threads = 1
    matmul: MatmulChoice = "mkl"
    progress: bool = True
