"""Compiled stage functions and dense kernels."""

from wbmpc.kernel.compiled import Kernel, build_kernel

__all__ = ["Kernel", "build_kernel"]
