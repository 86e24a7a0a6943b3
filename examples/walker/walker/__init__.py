"""Gymnasium's hard-core bipedal walker for uavrl: environment, reward, replay buffer and FORK's variant.

PYTHONPATH=examples/walker uavrl-train --config-dir examples/walker/conf packages=[walker] \
        env=bipedal_hardcore learner=td3_fork_walker trainer.episodes=1000
"""
