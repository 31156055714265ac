"""sysid: models of pendulums and joints with addable effects, and what identifies them from logs.

Conventions: theta = 0 upright, theta = pi hanging, positive torque raises theta; SI units.

    records = sysid.read("swing1.csv", "swing2.csv")
    estimate = sysid.fit(sysid.Model(sysid.PointMassPendulum(), dt=records.dt), records)
    diagnosis = sysid.diagnose(estimate, records)
    better = diagnosis.estimate
"""

import lazy_loader

# each name is loaded when it is first asked for, so that --help answers at once
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
