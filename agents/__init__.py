"""Agents: ways to move. Scripted and feedback laws behind one small interface, and the demonstration.

A policy reads observations only: see `agents.policy.Policy`. `agents.registry.make` builds one by its name.
"""

from agents.policy import Policy, Task
from agents.registry import AGENTS, make

__all__ = ["AGENTS", "Policy", "Task", "make"]
