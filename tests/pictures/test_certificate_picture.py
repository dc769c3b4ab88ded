"""The figure of a certificate."""

import numpy as np

import coadjoint as co

BODY = co.systems.rigid_body(inertia=(1, 2, 3))


def test_every_panel_is_drawn(tmp_path):
    for method in (co.Splitting(), co.Taylor(12), lambda x, h: x + h * BODY.vector_field(x)):
        found = co.certify(BODY, method, (0.3, 1.0, 0.2), 0.1, steps=60)
        figure = found.plot()
        figure.savefig(tmp_path / "certificate.png", dpi=50)
        errors, _, invariants, verdicts = figure.axes
        shown = np.sort(errors.lines[0].get_xdata())
        assert np.allclose(shown, np.sort(found["order"].evidence["steps"]))
        assert len(invariants.lines) == 2
        written = [text.get_text() for text in verdicts.texts]
        assert all(row.verdict in written for row in found.rows)
        assert ("nothing declared" if not found.declares else "passed") in figure.get_suptitle()


def test_what_could_not_be_measured_is_said():
    figure = co.certify(BODY, co.Splitting(), (1.0, 0.0, 0.0), 0.1, steps=20).plot()
    assert [text.get_text() for text in figure.axes[0].texts] == ["every state rests"]
