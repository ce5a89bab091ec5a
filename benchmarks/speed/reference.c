/* The arm in hand-written C, eight lanes wide: the physics alone, as a limit for the package's kernel.

   No reference, readings, reward or observation. Friction is a smooth curve that always acts, so no joint sticks.
   A block of eight lanes holds one row per state: position and velocity of both joints; with elastic joints also
   position and velocity of both motors. */

#define LANES 8
typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef long long whole __attribute__((vector_size(8 * LANES)));

typedef struct {
    double p1, p2, p3, p4, p5;         /* lumped parameters, see fbl_gym/model/arm.py */
    double viscous, coulomb, width;    /* friction: viscous v + coulomb v / sqrt(v^2 + width^2) */
    double stiffness, damping, rotor;  /* elastic joints: N m/rad, N m s/rad, kg m^2 */
} arm;

static inline lanes pick(whole mask, lanes yes, lanes no) { return (lanes)((mask & (whole)yes) | (~mask & (whole)no)); }

static inline lanes root(lanes x) {
    for (int i = 0; i < LANES; i++) x[i] = __builtin_sqrt(x[i]);
    return x;
}

/* Polynomials of FreeBSD's msun (k_sin.c, k_cos.c); the same reduction as fbl_gym/kernel/fastmath.py. */
static inline void sincos_lanes(lanes x, lanes *sine, lanes *cosine) {
    lanes shifted = x * 0.6366197723675814 + 6755399441055744.0;
    whole quadrant = (whole)shifted;
    lanes k = shifted - 6755399441055744.0;
    lanes r = (x - k * 1.5707963267948966) - k * 6.123233995736766e-17, z = r * r;
    lanes s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04
            + z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    lanes c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05
            + z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11)))));
    whole odd = (quadrant & 1) != 0;
    lanes a = pick(odd, c, s), b = pick(odd, s, c);
    *sine = pick((quadrant & 2) != 0, -a, a);
    *cosine = pick(((quadrant + 1) & 2) != 0, -b, b);
}

static inline lanes friction(const arm *m, lanes v) { return m->viscous * v + m->coulomb * v / root(v * v + m->width * m->width); }

/* Accelerations of the links under the torques t on them. */
static inline void links(const arm *m, const lanes *q, const lanes *v, const lanes *t, lanes *a) {
    lanes s1, c1, s2, c2;
    sincos_lanes(q[0], &s1, &c1);
    sincos_lanes(q[1], &s2, &c2);
    lanes m22 = m->p2 + 0.0 * c2, m12 = m->p2 + m->p3 * c2, m11 = m->p1 + m->p2 + 2.0 * m->p3 * c2, h = m->p3 * s2;
    lanes g2 = m->p5 * (c1 * c2 - s1 * s2);
    lanes f1 = t[0] + h * v[1] * (2.0 * v[0] + v[1]) - m->p4 * c1 - g2, f2 = t[1] - h * v[0] * v[0] - g2;
    lanes scale = 1.0 / (m11 * m22 - m12 * m12);
    a[0] = (m22 * f1 - m12 * f2) * scale;
    a[1] = (m11 * f2 - m12 * f1) * scale;
}

/* Derivative of a state under the torques u of the drives. */
static inline void slope(const arm *m, int elastic, const lanes *x, const lanes *u, lanes *dx) {
    lanes t[2];
    for (int i = 0; i < 2; i++) {
        dx[i] = x[2 + i];
        if (elastic) {
            t[i] = m->stiffness * (x[4 + i] - x[i]) + m->damping * (x[6 + i] - x[2 + i]);
            dx[4 + i] = x[6 + i];
            dx[6 + i] = (u[i] - t[i] - friction(m, x[6 + i])) / m->rotor;
        } else {
            t[i] = u[i] - friction(m, x[2 + i]);
        }
    }
    links(m, x, x + 2, t, dx + 2);
}

static inline void advance(const arm *m, int elastic, double *state, const double *torque, long blocks, int substeps, double h) {
    const int rows = elastic ? 8 : 4;
    for (long b = 0; b < blocks; b++) {
        lanes *x = (lanes *)(state + b * rows * LANES);
        const lanes *u = (const lanes *)(torque + b * 2 * LANES);
        for (int step = 0; step < substeps; step++) {
            lanes k1[8], k2[8], k3[8], k4[8], y[8];
            slope(m, elastic, x, u, k1);
            for (int i = 0; i < rows; i++) y[i] = x[i] + 0.5 * h * k1[i];
            slope(m, elastic, y, u, k2);
            for (int i = 0; i < rows; i++) y[i] = x[i] + 0.5 * h * k2[i];
            slope(m, elastic, y, u, k3);
            for (int i = 0; i < rows; i++) y[i] = x[i] + h * k3[i];
            slope(m, elastic, y, u, k4);
            for (int i = 0; i < rows; i++) x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        }
    }
}

void advance_rigid(const arm *m, double *state, const double *torque, long blocks, int substeps, double h) {
    advance(m, 0, state, torque, blocks, substeps, h);
}

void advance_elastic(const arm *m, double *state, const double *torque, long blocks, int substeps, double h) {
    advance(m, 1, state, torque, blocks, substeps, h);
}
