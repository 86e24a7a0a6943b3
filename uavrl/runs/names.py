"""The names in a run folder."""

LONGEST_NAME = 120  # characters that a file or folder is named by settings; a file system takes 255 bytes

CONFIG = "config.yaml"  # the resolved configuration
EPISODES = "episodes.csv"  # a row for each episode
SUMMARY = "summary.json"  # what the run came to, once it has ended
CHECKPOINTS = "checkpoints"  # a folder
ANY_CHECKPOINT = f"{CHECKPOINTS}/checkpoint*"  # from the first one on there is something to go on from
ARTIFACT = "artifact"  # a folder: a copy of ABR⁺'s classifier, so that the run can go on without the original
PRETRAINED = "pretrained"  # a folder: the artifact that uavrl-pretrain made of the run's states
LOGS = "logs"  # a folder: what the logger writes
LOCK, HOLDER = ".lock", ".holder.json"  # who trains here, and a sign of life
BEGUN = ".begun"  # the mark of a run folder: what has it was made by a training, and may be cleared before a checkpoint
DIRECTIONS = ("lidar_directions.csv", "lidar_directions.npy", "lidar_directions.txt")  # one: the rays of an own LiDAR
# What a training reads or writes.
TRAINING = (CONFIG, EPISODES, SUMMARY, CHECKPOINTS, ARTIFACT, LOGS, LOCK, HOLDER, BEGUN, *DIRECTIONS)
