"""The study of agents: what is trained and where it is evaluated, the runs and their statistics.

``settings`` says what is done, ``runs`` does it, ``statistics`` and ``results`` make numbers of it,
``report`` and ``pictures`` show them.
"""
