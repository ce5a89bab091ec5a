"""Small networks learn fastest on one thread, above all where others use the machine too."""

import importlib.util

if importlib.util.find_spec("torch") is None:  # without the extra `rl`
    collect_ignore_glob = ["test_*.py"]
else:
    import torch

    torch.set_num_threads(1)
