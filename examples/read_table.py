"""Read the table of a splitting without the library (docs/table.md), and give it other parameters."""

import numpy as np


def angles(table, part, x):
    """Return the derivatives of the terms of a part by their coordinates."""
    found = []
    for k in range(table["share"][part], table["share"][part + 1]):
        for row in range(table["term_row"][k], table["term_row"][k + 1]):
            entries = slice(table["entry"][row], table["entry"][row + 1])
            angle = table["offset"][row] + table["weight"][entries] @ x[table["column"][entries]]
            for m in range(table["monomial"][k], table["monomial"][k + 1]):
                factors = range(table["factor"][m], table["factor"][m + 1])
                powers = {table["target"][table["factor_row"][f]]: int(table["exponent"][f]) for f in factors}
                e = powers.get(table["target"][row], 0)
                rest = [x[i] ** (p - (i == table["target"][row])) for i, p in powers.items()]
                angle += table["coefficient_of_monomial"][m] * e * np.prod(rest) if e else 0.0
            found.append(angle)
    return np.array(found)


def product(table, entries, theta, x):
    """Return the sum of theta_a D_a x over some entries."""
    row, column, angle, value = (table["state_" + name][entries] for name in ("row", "column", "angle", "value"))
    return np.bincount(row, theta[angle] * value * x[column], minlength=len(x))


def entire_pair(z):
    """Return sinh(w)/w and (cosh(w) - 1)/w^2 with w^2 = z of either sign."""
    if abs(z) < 0.1:
        s = sum(z**k / float(np.prod(np.arange(1, 2 * k + 2))) for k in range(9))
        return s, sum(z**k / float(np.prod(np.arange(1, 2 * k + 3))) for k in range(9))
    w = np.sqrt(abs(z))
    return (np.sinh(w) / w, 2 * np.sinh(w / 2) ** 2 / z) if z > 0 else (np.sin(w) / w, -2 * np.sin(w / 2) ** 2 / z)


def apply_block(table, b, theta, x):
    """Return the exponential of a block, times x."""
    entries = slice(table["state_entry"][b], table["state_entry"][b + 1])
    angle = theta[table["state_angle"][entries][0]]
    if table["state_kind"][b] == 5:
        substeps = max(1, int(np.ceil(abs(angle) * table["state_norm"][b])))
        for _ in range(substeps):
            power = x
            for k in range(1, table["state_degree"][b] + 1):
                power = product(table, entries, theta / (substeps * k), power)
                x = x + power
        return x
    inside = np.isin(np.arange(len(x)), [table["state_row"][entries], table["state_column"][entries]])
    mean = angle * table["state_mean"][b] * inside
    first = product(table, entries, theta, x) - mean * x
    second = product(table, entries, theta, first) - mean * first
    s, c = entire_pair(angle**2 * table["state_lambda"][b])
    return np.exp(mean) * (x + s * first + c * second)


def body_flow(table, part, tau, x):
    """Return the flow of x' = sum theta_a(x) D_a x, by its power series in pieces."""
    own = np.flatnonzero(table["state_part"] == part)
    reach = 8 * abs(tau) * sum(abs(angles(table, part, x))) * max(abs(table["state_value"][own]))
    for _ in range(pieces := max(1, int(np.ceil(reach)))):
        terms = [x]
        for k in range(20):
            rates = [tau / (pieces * (k + 1)) * angles(table, part, term) for term in terms]
            terms.append(sum(product(table, own, rates[j], terms[k - j]) for j in range(k + 1)))
        x = sum(reversed(terms))
    return x


def run(table, x, h, steps):
    """Return the state after some steps, by the flows of the table."""
    if table["version"] > 3 or len(table["functions"]):
        raise ValueError("this reader knows tables up to version 3, without functions of the user")
    x, section, w = np.array(x, dtype=float), table["section"], np.where(table["frequency"], table["frequency"], 1.0)
    for k in range(steps + 1):
        first = 0 if k == 0 else 1 if k < steps else 2
        for row in range(section[first], section[first + 1]):
            part, tau = table["part"][row], table["coefficient"][row] * h
            if table["share"][part] in table["bodies"]:
                x = body_flow(table, part, tau, x)
                continue
            theta, own = tau * angles(table, part, x), slice(*table["term_row"][table["share"][part : part + 2]])
            rational = 2 * np.arctan(w[own] * theta / 2) / w[own]
            theta = np.where(table["frequency"][own] == 0, theta, rational)
            for b in range(table["state_block"][part], table["state_block"][part + 1]):
                x = apply_block(table, b, theta, x)
    return x


def coefficients(table, values):
    """Return the coefficients of the energy for other values of linear parameters, by name."""
    energy = table["energy"]["coefficients"].copy()
    for name, value in values.items():
        own = table["parameters"][name]
        energy[own["monomial"]] = 0.0
        np.add.at(energy, own["monomial"], own["derivative"] * np.ravel(value)[own["entry"]])
    return energy


def with_coefficients(table, energy):
    """Return the table for other coefficients of the energy."""
    shift, rest = after_shift(table, energy)
    fixed = [table["energy"]["monomials"][k] for k in table["fixed"] if energy[k] != table["energy"]["coefficients"][k]]
    if fixed:
        raise ValueError(f"the coefficients of {fixed} are fixed")
    numbers = {name: table[name].copy() for name in table["provenance"]}
    for name, own in table["provenance"].items():
        numbers[name][own["index"]] = own["factor"] * rest[own["monomial"]]
    return {**table, **numbers, "shift": shift, "energy": {**table["energy"], "coefficients": energy}}


def after_shift(table, energy):
    """Return the Casimirs, with their factors, and the coefficients after they were subtracted."""
    number = {tuple(key): k for k, key in enumerate(table["energy"]["monomials"])}
    found, rest = [], energy.copy()
    for shift in table["shift"]:
        keys = [tuple(i for i, power in enumerate(exponents) for _ in range(power)) for exponents in shift["exponents"]]
        casimir = {number[key]: float(c) for key, c in zip(keys, shift["coefficients"], strict=True)}
        removed = shift["monomial"]
        factor = shift["factor"] if removed is None else energy[removed] / casimir[removed]
        for k, c in casimir.items() if not table["bodies"] else ():
            rest[k] -= factor * c
        found.append({**shift, "factor": factor})
    return found, rest
