"""Work on tensors in place, launched as one CUDA graph: the cost of a step is its arithmetic, not its launches."""

from __future__ import annotations

from collections.abc import Callable

import torch

WARM = 3
"""Calls before the capture, in which libraries set up what they need."""


class CudaGraph:
    """Call `work()`, which reads and writes the same tensors every time; on a CUDA device, replay what it launched.

    On other devices it is called as it is. The work may neither wait for the device nor bring numbers to it.
    """

    def __init__(self, work: Callable[[], None], device: torch.device) -> None:
        self.work, self.device = work, device
        self._calls, self._graph = 0, None

    def __call__(self) -> None:
        if self.device.type != "cuda":
            self.work()
        elif self._graph is not None:
            self._graph.replay()
        elif self._calls < WARM:
            self._calls += 1
            self._aside()
        else:
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph):
                self.work()
            self._graph.replay()

    def _aside(self) -> None:
        """Once, on a stream of its own, as a capture asks for."""
        stream = torch.cuda.Stream(self.device)
        stream.wait_stream(torch.cuda.current_stream(self.device))
        with torch.cuda.stream(stream):
            self.work()
        torch.cuda.current_stream(self.device).wait_stream(stream)
