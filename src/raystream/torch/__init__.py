"""Queries as PyTorch operators, inside ``torch.compile`` and ``vmap``, with gradients."""

from raystream.torch.tracer import TorchHits, TorchTracer

__all__ = ["TorchHits", "TorchTracer"]
