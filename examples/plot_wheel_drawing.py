"""
A wheel in soil, labelled
=========================

Angles count from the vertical, positive ahead of it. The sinkage h is the depth of the rim's lowest point
below the undisturbed surface.
"""

import matplotlib.pyplot as plt
import numpy as np

r, h = 1.0, 0.28
entry = np.arccos(1.0 - h / r)
largest, leave = 0.45 * entry, -0.35 * entry


def rim(theta, radius=r):
    """Points of a circle around the hub; theta from the vertical, positive ahead."""
    return radius * np.sin(theta), r - h - radius * np.cos(theta)


figure, axis = plt.subplots(figsize=(5, 3.6), layout="constrained")
axis.plot(*rim(np.linspace(-np.pi, np.pi, 400)), color="black", linewidth=2)
front, back = rim(entry)[0], rim(leave)
axis.plot([front, 1.9], [0.0, 0.0], color="tab:brown", linewidth=2)
axis.plot([-1.7, back[0]], [back[1], back[1]], color="tab:brown", linewidth=2)
axis.plot(*rim(np.linspace(leave, entry, 100)), color="tab:brown", linewidth=4, alpha=0.5)
for theta, name, reach in (
    (entry, r"$\theta_f$", 0.62),
    (largest, r"$\theta_m$", 0.45),
    (leave, r"$\theta_r$", 0.45),
):
    axis.plot(*np.transpose([rim(0.0, 0.0), rim(theta)]), color="0.5", linewidth=1)
    axis.plot(*rim(np.linspace(0.0, theta, 40), reach), color="#0072B2", linewidth=1)
    x, z = rim(0.55 * theta, reach + 0.09)
    axis.text(x, z, name, color="#0072B2", ha="center", va="center", fontsize=12)
axis.plot(*np.transpose([rim(0.0, 0.0), rim(0.0)]), color="0.5", linewidth=1, linestyle="--")
arrow = {"arrowstyle": "-|>", "color": "#D55E00", "linewidth": 1.6}
hub = rim(0.0, 0.0)
for end, name, place in (
    ((hub[0] + 0.75, hub[1]), "$F_x$", (hub[0] + 0.8, hub[1] - 0.03)),
    ((hub[0], hub[1] + 0.75), "$F_z$", (hub[0] + 0.05, hub[1] + 0.65)),
):
    axis.annotate("", end, hub, arrowprops=arrow)
    axis.text(*place, name, color="#D55E00")
axis.annotate("", (1.75, 1.5), (1.1, 1.5), arrowprops={"arrowstyle": "-|>", "linewidth": 1.4})
axis.text(1.15, 1.56, "$v$, travel")
axis.text(1.08, 1.12, r"$\omega$", fontsize=13)
axis.annotate(
    "",
    rim(2.1, 1.12),
    rim(2.6, 1.12),
    arrowprops={"arrowstyle": "-|>", "linewidth": 1.4, "connectionstyle": "arc3,rad=-0.25"},
)
axis.plot([0.0, 1.55], [-h, -h], color="0.6", linewidth=0.8, linestyle=":")
axis.annotate("", (1.45, -h), (1.45, 0.0), arrowprops={"arrowstyle": "<->", "linewidth": 1.2})
axis.text(1.5, -0.5 * h, "$h$", va="center")
axis.annotate("", rim(-1.9), hub, arrowprops={"arrowstyle": "-|>", "color": "0.4"})
axis.text(*rim(-1.75, 0.55), "$r$")
for theta in np.linspace(leave, entry, 9)[1:-1]:
    tip, tail = rim(theta), rim(theta, r + 0.16 * np.exp(-((theta - largest) ** 2) / 0.12))
    axis.annotate("", tip, tail, arrowprops={"arrowstyle": "-|>", "color": "#009E73", "linewidth": 1.0})
axis.text(*rim(largest, r + 0.27), r"$\sigma$", color="#009E73", fontsize=12)
axis.set(aspect="equal", xlim=(-1.8, 2.0), ylim=(-0.6, 1.95))
axis.axis("off")
plt.show()
