"""The Euler equations of the plane torus and of the sphere by pseudo-spectral methods, for comparison."""

import numpy as np


def rk4(rate, x, t, steps):
    h = t / steps
    for _ in range(steps):
        a = rate(x)
        b = rate(x + h / 2 * a)
        c = rate(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + rate(x + h * c))
    return x


class Sphere:
    """Coefficients [l, m] up to the degree L, products on a grid of Gauss without aliases."""

    def __init__(self, L, rotation=0.0):
        self.L, self.rotation = L, rotation
        self.rows = 3 * L // 2 + 2
        m, l = np.divmod(np.arange((L + 1) ** 2), L + 1)
        self.l, self.m = l[l >= m], m[l >= m]
        self.mu = np.polynomial.legendre.leggauss(self.rows)[0][::-1]

    def slopes(self, alm):
        """Return the derivatives southward and eastward of a field."""
        from ducc0.sht import synthesis_2d

        return synthesis_2d(
            alm=alm[None], spin=1, lmax=self.L, geometry="GL", ntheta=self.rows, nphi=2 * self.rows, mode="DERIV1"
        )

    def rate(self, alm):
        from ducc0.sht import analysis_2d

        psi = -alm / np.maximum(self.l * (self.l + 1), 1)
        south, east = self.slopes(psi)
        u, v = south, east  # u eastward is -d psi/d latitude, v northward is d psi/d longitude over the cosine
        omega_south, omega_east = self.slopes(alm)
        # beside the advection, the frame that turns moves air over the planetary vorticity 2 rotation mu
        change = -(u * omega_east - v * omega_south) - v * 2 * self.rotation * np.sqrt(1 - self.mu**2)[:, None]
        return analysis_2d(map=np.ascontiguousarray(change)[None], spin=0, lmax=self.L, geometry="GL")[0]

    def solve(self, c, t, steps):
        """Return c [l, m] of the relative vorticity after a time."""
        N = len(c)
        alm = np.zeros(len(self.l), dtype=complex)
        inside = self.l < N
        alm[inside] = c[self.l[inside], self.m[inside]]
        alm = rk4(self.rate, alm, t, steps)
        found = np.zeros((self.L + 1, self.L + 1), dtype=complex)
        found[self.l, self.m] = alm
        return found


def torus(field, t, steps):
    """Return values (n, n) of the vorticity on the torus of side 2 pi after a time."""
    n = len(field)
    k = np.fft.fftfreq(n, 1 / n)
    kx, ky = k[:, None], k[None, :]
    squares = np.where(kx**2 + ky**2 == 0, 1.0, kx**2 + ky**2)
    kept = (np.abs(kx) < n / 3) & (np.abs(ky) < n / 3)

    def rate(w):
        psi = -w / squares
        u, v, wx, wy = (np.fft.ifft2(f).real for f in (-1j * ky * psi, 1j * kx * psi, 1j * kx * w, 1j * ky * w))
        return -np.fft.fft2(u * wx + v * wy) * kept

    return np.fft.ifft2(rk4(rate, np.fft.fft2(field) * kept, t, steps)).real
