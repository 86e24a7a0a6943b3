"""Out of the simulator: scans of a real LiDAR, what a policy reads of them, an autopilot. Most of it needs numpy alone.

Names are imported from the modules: `sources` (one iterator of scans), with `packets`, `scans`, `pcap`, `udp` and
`bags` below it; `reduction`, `observation` and `motion` (the maths of :mod:`uavrl.transforms`); `summary`; `autopilot`
(MAVLink), with `vehicle`, `firmware` and `frames` below it; `safety`, with `limits` below it; `policy`, with `contract`
below it. `policy` also needs pydantic and ONNX Runtime. `export`, with `onnx_export` and `motion_terms` below it,
writes what `policy` reads, and `simulated` flies that in the simulator: these need PyTorch.
"""
