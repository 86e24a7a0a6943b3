"""From a run to policy.onnx and contract.json."""
