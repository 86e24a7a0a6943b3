"""Somebody's own parts for uavrl: reward, penalties, perception, environment, each chosen by a yaml file in ``conf``.

PYTHONPATH=examples/own_parts uavrl-train --config-dir examples/own_parts/conf packages=[own_parts] \
        env=corridor reward=hurry actor_penalty=calm trainer.episodes=200 algo.learning_starts=500
PYTHONPATH=examples/own_parts uavrl-train --config-dir examples/own_parts/conf packages=[own_parts] perception=sectors
"""
