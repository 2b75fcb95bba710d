"""Stands in for torch under the stub trainer, where only its presence is asked for."""

__version__ = "0.stub"


class cuda:
    is_available = staticmethod(lambda: False)


def get_num_threads() -> int:
    return 1
