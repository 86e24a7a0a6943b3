"""Out of the simulator: scans of a real LiDAR, and what a policy reads of them. Needs numpy alone.

Names are imported from the modules: `sources` (one iterator of scans), with `packets`, `scans`, `pcap`, `udp` and
`bags` below it; `reduction` and `observation` (the maths of :mod:`uavrl.transforms`); `summary`.
"""
