"""What every hostile input must get: an answer, or one sentence that says why not."""

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

import sysid
from sysid.errors import LONGEST_SHOWN, InvalidInput

MODEL = sysid.Model(
    sysid.RodPendulum(g=9.81), (sysid.Viscous(b=0.1), sysid.Delay(T=0.02)), sysid.RK4(2), dt=0.05, u_max=2.0
)
ESC = "\x1b[31m"

many = settings(max_examples=300, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))


def answered(call, *arguments):
    """Whether a call answers; that it refuses in one short printable sentence else. Anything else is raised."""
    try:
        call(*arguments)
    except InvalidInput as refusal:
        text = str(refusal)
        assert text and len(text) <= 4 * LONGEST_SHOWN
        assert text.isprintable() or all(c.isprintable() or c.isspace() for c in text)
        assert "\n" not in text and "Error" not in text and "Traceback" not in text
        return False
    return True


def refused(main, words, capsys):
    """What a command line says of bad input: one line, exit code 2."""
    assert main(words) == 2
    said = capsys.readouterr()
    assert said.err.startswith("error: ") and said.err.count("\n") == 1 and "\x1b" not in said.out + said.err
    return said.err


CELLS = st.one_of(
    st.floats().map(repr),
    st.sampled_from(["", "nan", "1e308", "-1e400", "1e-320", "1_0", "0x10", "\u0661", ESC, "x" * 5000]),
    st.text(max_size=5),
)

T = 0.02 * np.arange(200)
ARRAYS = {"t": T, "theta": 3.0 + np.sin(3.0 * T), "theta_dot": 3.0 * np.cos(3.0 * T), "torque": np.cos(T)}
