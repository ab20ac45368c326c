"""Minimises the cost of a pose graph in g2o's text with scipy, and prints it.

    python3 scipy_cost.py graph.g2o [phi]

The cost is half the sum of the squared errors of log(measured^-1 * from^-1 * to), a twist (v, w). The text's information
is that of (t, q_vec), half the rotation vector. With phi, edges whose ids do not follow each other count as dynamic
covariance scaling has them. Needs numpy and scipy only.
"""

import sys

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def hat(w):
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def left_jacobian(w):
    angle = np.linalg.norm(w)
    if angle < 1e-5:
        return np.eye(3) + 0.5 * hat(w) + hat(w) @ hat(w) / 6.0
    axis = hat(w / angle)
    return np.eye(3) + (1 - np.cos(angle)) / angle * axis + (1 - np.sin(angle) / angle) * axis @ axis


def exp(twist):
    return Rotation.from_rotvec(twist[3:]), left_jacobian(twist[3:]) @ twist[:3]


def log(pose):
    w = pose[0].as_rotvec()
    return np.concatenate([np.linalg.solve(left_jacobian(w), pose[1]), w])


def inverse(pose):
    rotation = pose[0].inv()
    return rotation, -rotation.apply(pose[1])


def compose(a, b):
    return a[0] * b[0], a[0].apply(b[1]) + a[1]


def read(path):
    poses, fixed, edges = {}, set(), []
    pose = lambda f: (Rotation.from_quat([float(v) for v in f[3:7]]), np.array([float(v) for v in f[:3]]))
    for fields in (line.split() for line in open(path)):
        if fields[0] == "VERTEX_SE3:QUAT":
            poses[int(fields[1])] = pose(fields[2:])
        elif fields[0] == "FIX":
            fixed.update(int(v) for v in fields[1:])
        elif fields[0] == "EDGE_SE3:QUAT":
            information = np.zeros((6, 6))
            information[np.triu_indices(6)] = [float(v) for v in fields[10:]]
            information += np.triu(information, 1).T
            half = np.diag([1.0, 1.0, 1.0, 0.5, 0.5, 0.5])
            root = np.linalg.cholesky(half @ information @ half).T
            edges.append((int(fields[1]), int(fields[2]), pose(fields[3:]), root))
        else:
            sys.exit(f"unknown tag {fields[0]}")
    return poses, fixed, edges


def main():
    poses, fixed, edges = read(sys.argv[1])
    phi = float(sys.argv[2]) if len(sys.argv) > 2 else None
    places = {node: at for at, node in enumerate(n for n in poses if n not in fixed)}

    def pose(x, node):
        at = places.get(node)
        return poses[node] if at is None else compose(poses[node], exp(x[6 * at : 6 * at + 6]))

    def residual(x, edge):
        a, b, measured, root = edge
        error = root @ log(compose(inverse(measured), compose(inverse(pose(x, a)), pose(x, b))))
        chi2 = error @ error
        if phi is not None and abs(a - b) != 1 and chi2 > phi:
            # So that the sum of squares is the kernel's cost.
            error = error * np.sqrt(phi * (3 * chi2 - phi) / (chi2 + phi) / chi2)
        return error

    def jacobian(x, step=1e-5):
        """Central differences; only an edge's own nodes move it."""
        found = np.zeros((6 * len(edges), len(x)))
        for row, edge in enumerate(edges):
            for at in (places[node] for node in edge[:2] if node in places):
                for column in range(6 * at, 6 * at + 6):
                    there, back = x.copy(), x.copy()
                    there[column] += step
                    back[column] -= step
                    found[6 * row : 6 * row + 6, column] = (residual(there, edge) - residual(back, edge)) / (2 * step)
        return found

    start = np.zeros(6 * len(places))
    residuals = lambda x: np.concatenate([residual(x, edge) for edge in edges])
    found = least_squares(residuals, start, jacobian, ftol=1e-13, xtol=1e-13, gtol=1e-8, max_nfev=200)
    print(f"{found.cost:.12g}")


if __name__ == "__main__":
    main()
