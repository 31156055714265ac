"""The multiple-shooting problem as IPOPT sees it: variables, continuity constraints, sparse derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray

from sysid.estimation.identifiers.sensitivity import Segments
from sysid.physics.ops import Array
from sysid.physics.parameters import Parameter

Index = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the solver stopped: p (P,), nodes (M, 2), half the whitened sum of squares, whether it converged."""

    p: Array
    nodes: Array
    cost: float
    success: bool


class MultipleShooting:
    """min 1/2 |R(nodes, p)|^2 subject to end_i(node_i, p) = node_(i+1) within a record and low <= p <= high.

    Variables are v = (p / scale, node_0, ..., node_(M-1)). The Hessian of the Lagrangian is exact: Gauss-Newton's
    is not enough where a rollout passes close to the upright and small causes grow. The cost of an iteration is
    linear in the number of samples.
    Without `continuity` each segment is a window with a free state of its own.
    """

    def __init__(
        self,
        segments: Segments,
        parameters: Sequence[Parameter],
        continuity: bool = True,
        max_iterations: int = 100,
        tolerance: float = 1e-8,
    ) -> None:
        scale = np.array([p.scale for p in parameters])
        self.segments, self.scale = segments, scale
        self.low, self.high = (np.array([p.bounds[side] for p in parameters]) / scale for side in (0, 1))
        P, M = len(scale), segments.size
        v = casadi.MX.sym("v", P + 2 * M)
        p, nodes = v[:P] * casadi.DM(scale), casadi.reshape(v[P:], 2, M)
        cost, end, gradient, end_z, _ = segments.symbolic(p, nodes)
        inner = np.flatnonzero(segments.continued) if continuity else np.array([], dtype=int)
        f = casadi.sum2(cost)
        g = casadi.vec(end[:, inner.tolist()] - nodes[:, (inner + 1).tolist()])
        lam_f, lam_g = casadi.MX.sym("lam_f"), casadi.MX.sym("lam_g", g.numel())
        # a segment's multiplier is that of the constraint that ties its end to the next node
        tied = casadi.DM.triplet(list(range(len(inner))), inner.tolist(), casadi.DM.ones(len(inner)), len(inner), M)
        multipliers = casadi.mtimes(casadi.reshape(lam_g, 2, len(inner)), tied)
        curvature = segments.hessian(p, nodes, lam_f, multipliers)
        functions = self._derivatives(v, f, g, gradient, end_z, curvature, inner, lam_f, lam_g)
        self.solver = casadi.nlpsol(
            "fit",
            "ipopt",
            {"x": v, "f": f, "g": g},
            {
                **functions,
                "print_time": False,
                "show_eval_warnings": False,
                "ipopt": {
                    "print_level": 0,
                    "sb": "yes",
                    "max_iter": max_iterations,
                    "tol": tolerance,
                    "bound_relax_factor": 0.0,
                    "bound_push": 1e-6,
                    "bound_frac": 1e-6,
                    "mu_strategy": "adaptive",
                },
            },
        )

    def _derivatives(
        self,
        v: casadi.MX,
        f: casadi.MX,
        g: casadi.MX,
        gradient: casadi.MX,
        end_z: casadi.MX,
        curvature: casadi.MX,
        inner: Index,
        lam_f: casadi.MX,
        lam_g: casadi.MX,
    ) -> dict[str, casadi.Function]:
        """IPOPT's derivative functions, assembled from the segments' dense blocks."""
        P, M, n = len(self.scale), self.segments.size, v.numel()
        Z = 2 + P
        # the columns of v that a segment's z = (node, p) stands for, and dz/dv
        columns = np.array([[P + 2 * i, P + 2 * i + 1, *range(P)] for i in range(M)])
        factor = np.concatenate([np.ones(2), self.scale])
        no_parameter = casadi.MX.sym("none", 0)

        grad_f = casadi.vertcat(casadi.sum2(gradient[2:, :]) * casadi.DM(self.scale), casadi.vec(gradient[:2, :]))

        rows_g = np.arange(2 * len(inner)).reshape(-1, 2)
        row = np.repeat(rows_g[:, None, :], Z, axis=1)  # end_z is vectorised column by column
        col = np.repeat(columns[inner][:, :, None], 2, axis=2)
        scaled = end_z[:, inner.tolist()] * casadi.repmat(casadi.DM(np.repeat(factor, 2)), 1, len(inner))
        jac_g = _assemble(row, col, casadi.vec(scaled), (g.numel(), n))
        if len(inner):
            follow = np.array([[P + 2 * (i + 1), P + 2 * (i + 1) + 1] for i in inner]).ravel()
            jac_g = jac_g - casadi.DM.triplet(
                list(range(g.numel())), follow.tolist(), casadi.DM.ones(g.numel()), g.numel(), n
            )

        row = np.repeat(columns[:, None, :], Z, axis=1)
        col = np.repeat(columns[:, :, None], Z, axis=2)
        scaled = curvature * casadi.repmat(casadi.DM(np.outer(factor, factor).ravel()), 1, M)
        hessian = _assemble(row, col, casadi.vec(scaled), (n, n))
        return {
            "grad_f": casadi.Function("nlp_grad_f", [v, no_parameter], [f, grad_f], ["x", "p"], ["f", "grad_f_x"]),
            "jac_g": casadi.Function("nlp_jac_g", [v, no_parameter], [g, jac_g], ["x", "p"], ["g", "jac_g_x"]),
            "hess_lag": casadi.Function(
                "nlp_hess_l",
                [v, no_parameter, lam_f, lam_g],
                [casadi.triu(hessian)],
                ["x", "p", "lam_f", "lam_g"],
                ["triu_hess_gamma_x_x"],
            ),
        }

    def solve(self, p: Array, nodes: Array) -> Solution:
        """The local optimum reached from parameters p (P,) and nodes (M, 2)."""
        P = len(p)
        free = np.full(nodes.size, np.inf)
        result = self.solver(
            x0=np.concatenate([p / self.scale, nodes.ravel()]),
            lbx=np.concatenate([self.low, -free]),
            ubx=np.concatenate([self.high, free]),
            lbg=0.0,
            ubg=0.0,
        )
        v = np.asarray(result["x"]).ravel()
        return Solution(
            p=np.clip(v[:P], self.low, self.high) * self.scale,
            nodes=v[P:].reshape(-1, 2),
            cost=float(result["f"]),
            success=bool(self.solver.stats()["success"]),
        )


def _assemble(row: Index, col: Index, values: casadi.MX, shape: tuple[int, int]) -> casadi.MX:
    """A sparse matrix from triplets; values of the same place add up."""
    row, col = row.ravel().astype(int), col.ravel().astype(int)
    place, slot = np.unique(col * shape[0] + row, return_inverse=True)
    sparsity = casadi.Sparsity.triplet(*shape, (place % shape[0]).tolist(), (place // shape[0]).tolist())
    gather = casadi.DM.triplet(slot.tolist(), list(range(len(slot))), casadi.DM.ones(len(slot)), len(place), len(slot))
    return casadi.MX(sparsity, casadi.mtimes(casadi.MX(gather), values))
