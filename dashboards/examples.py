"""Study files to begin with, for those who have none at hand."""

from __future__ import annotations

EXAMPLES = (
    {
        "title": "Different ways to jump over a bar",
        "text": """\
# Different ways to jump over a bar: minutes on two cores.
name: my-jumps
task:
  name: high_jump
  settings: {formulation: support, feature: facing}
space:
  alpha: {type: float, low: 0.5, high: 1.8}      # rad: the angle of the bar to the run-up
  omega_x: {type: float, low: -3.0, high: 1.0}   # rad/s
  omega_z: {type: float, low: -4.0, high: 4.0}   # rad/s
  v_z: {type: float, low: -2.5, high: -1.0}      # m/s
search: {strategy: bds, trials: 18}
training:
  budget: {samples: 9000}
  network: {hidden: [256, 128]}
resources: {parallel: 2}
""",
    },
    {
        "title": "The best settings of a small jumper",
        "text": """\
# The best settings of a point mass that jumps: easy versions first, whole ones for the answer. Seconds.
name: my-hops
task: point_jump
search: {strategy: cmfbo, trials: 20}
training: {budget: {samples: 600}}
""",
    },
    {
        "title": "A Gymnasium environment, its learning tuned",
        "text": """\
# Learning rate and batch of a learner on any Gymnasium environment.
name: my-pendulum
task: gymnasium:Pendulum-v1
search: {strategy: tpe, trials: 20}
training: {budget: {samples: 20000}}
resources: {parallel: 2}
""",
    },
)
"""Title and text of each. A test checks that the service takes them."""
