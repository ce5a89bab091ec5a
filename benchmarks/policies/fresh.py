"""The server of isolated calls, as a script: its socket and the search path are the arguments.

It imports what most calls need, and nothing later. A key follows what a policy imports (`key.py`),
so what a new process has must not depend on the calls before.
"""

import sys

if __name__ == "__main__":
    sys.path[:] = sys.argv[2:]  # before any other import: the script's folder is no place for modules

    import benchmarks.policies.spec  # noqa: F401  most of what a call needs
    from benchmarks.policies.isolation import serve
    from fbl_gym.envs.vector_env import TwoLinkArmVectorEnv

    env = TwoLinkArmVectorEnv(2)  # loads the compiled functions
    env.reset(seed=0)
    env.step(env.action_space.sample())
    serve(sys.argv[1])
