"""Where twin and simulator meet: logs of simulated runs, oracle, environment wrapper.

May import usv_gym and the rest of the twin but agents, benchmark, live and cli.
"""
