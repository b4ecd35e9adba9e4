"""Policies in Python as they should not be; noctule.policies.widest is one as it should."""

import math
import os
import time

from noctule.policy import Goal, Policy


class Throws(Policy):
    def step(self, view, pose, budget_cells):
        raise RuntimeError("no idea")


class ThrowsAtBirth(Policy):
    def __init__(self):
        raise RuntimeError("not even begun")


class NoNumber(Policy):
    def step(self, view, pose, budget_cells):
        return Goal(math.nan, 0.0)


class Outside(Policy):
    def step(self, view, pose, budget_cells):
        return Goal(500.0, 500.0)


class InWall(Policy):
    def step(self, view, pose, budget_cells):
        rows, columns = view.occupied.nonzero()
        return Goal(*view.place(rows[0], columns[0]))


class WrongType(Policy):
    def step(self, view, pose, budget_cells):
        return "over there"


class Stalls(Policy):
    def step(self, view, pose, budget_cells):
        time.sleep(3600)


class Dies(Policy):
    def step(self, view, pose, budget_cells):
        os._exit(3)


class Idle(Policy):
    def step(self, view, pose, budget_cells):
        return None
