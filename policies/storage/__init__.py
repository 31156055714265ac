"""Trained policies on disk: policy_file (safetensors and JSON), onnx_file."""
