"""Negative controls: wrong systems, schemes and steps fail the measures that correct ones pass."""

from digests.measures import order_of


def test_slope_fit_separates_neighbouring_orders():
    h = [0.2 / 2 ** (k / 2) for k in range(5)]
    for p in (1, 2, 4, 8):
        found = order_of(h, [3 * x**p * (1 + 0.8 * x) for x in h], 1)
        assert found.agrees_with(p)
        assert not found.agrees_with(p + 1) and not found.agrees_with(p - 1)
    # A plateau agrees with no order.
    assert not any(order_of(h, [1e-12 * (1 + 0.3 * (-1) ** k) for k in range(5)], 1).agrees_with(p) for p in (1, 2, 4))
