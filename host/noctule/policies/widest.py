"""An example of a policy in Python: `noctule fly maze_a --policy noctule.policies.widest:Widest`.

Looks at the piece of the edge of the unknown that shows the most for the way there, and stays with it until it is seen.
"""

from noctule.policy import FINISHED, UNDER_WAY, Goal, Policy

LOOK_S = 0.5             # so often it sees whether its goal has been seen, and so long it looks
SAME_M = 0.5             # a frontier that moved by less is the same one
PATIENCE_S = 1.0         # nothing left for so long: finished


class Widest(Policy):
    """Goal: the frontier with the greatest length for its distance."""

    def begin(self, home):
        self.goal, self.looked_s, self.empty_s = None, -LOOK_S, None
        self.tried = []                              # places that led nowhere

    def step(self, view, pose, budget_cells):
        if self.goal is not None and (view.fate != UNDER_WAY or view.at_goal_s > LOOK_S):
            self.tried.append(self.goal.look)        # unreachable, stuck, refused, or looked at in vain: not again
            self.goal = None
        if budget_cells == 0 or (self.goal is not None and view.t_s - self.looked_s < LOOK_S):
            return self.goal
        self.looked_s = view.t_s
        fronts = [f for f in view.frontiers() if all(abs(f.x_m - x) + abs(f.y_m - y) > SAME_M for x, y in self.tried)]
        if not fronts:
            self.goal = None
            self.empty_s = view.t_s if self.empty_s is None else self.empty_s
            return FINISHED if view.t_s - self.empty_s > PATIENCE_S else None
        self.empty_s = None
        if self.goal is not None and any(abs(f.x_m - self.goal.look[0]) + abs(f.y_m - self.goal.look[1]) < SAME_M for f in fronts):
            return self.goal                         # still to be seen
        best = max(fronts, key=lambda f: f.cells / (1.0 + f.way_m))
        self.goal = Goal(best.view_x_m, best.view_y_m, look=(best.x_m, best.y_m))
        return self.goal
