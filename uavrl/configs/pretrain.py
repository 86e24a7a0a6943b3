"""Typed configuration of ``uavrl-pretrain``. Meanings and units stand in the yaml."""

from __future__ import annotations

from dataclasses import dataclass, field

from uavrl.configs.checks import require, require_products, require_widths

THESIS_CLUSTERS = (100, 250, 500, 750, 1000, *range(1500, 6001, 500))


@dataclass
class PretrainRecipe:
    """conf/pretrain: how much of everything."""

    name: str = "full"
    states: int = 200_000
    features: int = 20
    hidden: int = 64
    tradeoff: float = 0.7
    psae_epochs: int = 60
    psae_batch_size: int = 256
    psae_lr: float = 1e-3
    clusters: tuple[int, ...] = THESIS_CLUSTERS
    k: int | None = None
    kmeans_batch_size: int = 4096
    kmeans_iterations: int = 30
    classifier_hidden: tuple[int, ...] = (64,)
    classifier_epochs: int = 40
    classifier_batch_size: int = 512
    classifier_lr: float = 3e-3
    held_out: float = 0.1
    compare_k: int | None = 4000
    one_shot: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        counts = ("states", "features", "hidden", "psae_epochs", "psae_batch_size", "kmeans_batch_size")
        for key in (*counts, "kmeans_iterations", "classifier_epochs", "classifier_batch_size"):
            require(getattr(self, key) >= 1, f"pretrain.{key}", "at least 1", getattr(self, key))
        for key in ("psae_lr", "classifier_lr"):
            require(getattr(self, key) > 0, f"pretrain.{key}", "above 0", getattr(self, key))
        require(0 <= self.tradeoff <= 1, "pretrain.tradeoff", "in [0, 1]", self.tradeoff)
        require(0 < self.held_out < 1, "pretrain.held_out", "in (0, 1)", self.held_out)
        require_widths(self.classifier_hidden, "pretrain.classifier_hidden")
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

    run: str | None = None
    recording: str | None = None
    output: str | None = None
    pretrain: PretrainRecipe = field(default_factory=PretrainRecipe)
    seed: int = 0
    threads: int = 1
    products: str = "mkl"
    progress: bool = True

    def __post_init__(self) -> None:
        """Checks ranges."""
        require(0 <= self.seed < 2**31, "seed", "in [0, 2**31)", self.seed)
        require_products(self.products)
        require(self.threads >= 1, "threads", "at least 1", self.threads)


PRETRAIN_GROUPS: dict[str, dict[str, type]] = {"pretrain": {"quick": PretrainRecipe, "full": PretrainRecipe}}
