/* The arm in hand-written C, eight lanes wide, as a limit for the package's kernel.

   First the physics of a rigid arm alone: no reference, readings, reward or observation. Friction is a smooth curve
   that always acts, so no joint sticks. A block of eight lanes holds one row per state: position and velocity of both
   joints. */

#define LANES 8
typedef double lanes __attribute__((vector_size(8 * LANES)));
typedef long long whole __attribute__((vector_size(8 * LANES)));

typedef struct {
    double p1, p2, p3, p4, p5;         /* lumped parameters, see fbl_gym/model/arm.py */
    double viscous, coulomb, width;    /* friction: viscous v + coulomb v / sqrt(v^2 + width^2) */
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
static inline void slope(const arm *m, const lanes *x, const lanes *u, lanes *dx) {
    lanes t[2];
    for (int i = 0; i < 2; i++) {
        dx[i] = x[2 + i];
        t[i] = u[i] - friction(m, x[2 + i]);
    }
    links(m, x, x + 2, t, dx + 2);
}

void advance_rigid(const arm *m, double *state, const double *torque, long blocks, int substeps, double h) {
    for (long b = 0; b < blocks; b++) {
        lanes *x = (lanes *)(state + b * 4 * LANES);
        const lanes *u = (const lanes *)(torque + b * 2 * LANES);
        for (int step = 0; step < substeps; step++) {
            lanes k1[4], k2[4], k3[4], k4[4], y[4];
            slope(m, x, u, k1);
            for (int i = 0; i < 4; i++) y[i] = x[i] + 0.5 * h * k1[i];
            slope(m, y, u, k2);
            for (int i = 0; i < 4; i++) y[i] = x[i] + 0.5 * h * k2[i];
            slope(m, y, u, k3);
            for (int i = 0; i < 4; i++) y[i] = x[i] + h * k3[i];
            slope(m, y, u, k4);
            for (int i = 0; i < 4; i++) x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        }
    }
}

/* The same work as the kernel's of a busy arm and of an elastic one: friction that sticks, torque, readings with their errors.
   Each lane has its own arm. Still without reference, reward, observation, payload and events. */

typedef unsigned long long word;

typedef struct {
    lanes q[2], v[2], motor_q[2], motor_v[2];                          /* the state */
    lanes p[5], viscous[2], coulomb[2], stiction[2], v_s[2], load[2];  /* the arm */
    lanes stiffness[2], damping[2], backlash[2], rotor[2];             /* elastic joints */
    lanes gain[2], delay, lag;                                         /* the drive: its times in physics steps */
    lanes command[2], before[2], lagged[2];                            /* the command, the one before, and the lagged one */
    lanes push[2], reading[6], encoder[2];                             /* disturbance, readings, the last position readings */
} block;

typedef struct {
    double h, substeps, period, amplitude, quantum;  /* of a disturbance's level [control steps] and size, of the encoder */
    double noise[3];                                 /* of position, velocity and acceleration */
} task;

static inline lanes larger(lanes a, lanes b) { return pick(a > b, a, b); }
static inline lanes smaller(lanes a, lanes b) { return pick(a < b, a, b); }
static inline lanes size_of(lanes x) { return (lanes)((whole)x & 0x7fffffffffffffffLL); }
static inline lanes shrink(lanes x, lanes bound) { return larger(x - bound, 0.0 * x) + smaller(x + bound, 0.0 * x); }
static inline lanes limit(lanes x, double bound) { return larger(smaller(x, 0.0 * x + bound), 0.0 * x - bound); }

static inline lanes lower(lanes x) {
    for (int i = 0; i < LANES; i++) x[i] = __builtin_floor(x[i]);
    return x;
}

static inline lanes exp_lanes(lanes x) {
    lanes shifted = limit(x, 700.0) * 1.4426950408889634 + 6755399441055744.0, k = shifted - 6755399441055744.0;
    lanes r = (x - k * 0.6931471805599453) - k * 2.3190468138462996e-17, p = r * (1.0 / 6227020800.0) + 1.0 / 479001600.0;
    static const double terms[] = {1.0 / 39916800, 1.0 / 3628800, 1.0 / 362880, 1.0 / 40320, 1.0 / 5040, 1.0 / 720, 1.0 / 120,
                                   1.0 / 24, 1.0 / 6, 0.5, 1.0, 1.0};
    for (int i = 0; i < 12; i++) p = p * r + terms[i];
    return p * (lanes)(((whole)shifted + 1023) << 52);
}

static inline lanes log_lanes(lanes x) {
    whole e = ((whole)x - 0x3FE6A09E667F3BCDLL) >> 52;
    lanes m = (lanes)((whole)x - (e << 52)), k = (lanes)(e + 0x4338000000000000LL) - 6755399441055744.0;
    lanes s = (m - 1.0) / (m + 1.0), z = s * s, p = z * (1.0 / 21) + 1.0 / 19;
    for (int i = 17; i > 1; i -= 2) p = p * z + 1.0 / i;
    return k * 0.6931471805599453 + 2.0 * (s * z * p + s);
}

/* Two words of Philox4x64-10 of each lane as numbers in [0, 1): stream, lane and control step as key and counter. */
static inline void uniforms(word stream, word lane, word step, lanes *a, lanes *b) {
    for (int i = 0; i < LANES; i++) {
        word k0 = lane + i, k1 = stream, c0 = step, c1 = 0, c2 = 0, c3 = 0;
        for (int round = 0; round < 10; round++, k0 += 0x9E3779B97F4A7C15ULL, k1 += 0xBB67AE8584CAA73BULL) {
            unsigned __int128 x = (unsigned __int128)0xD2E7470EE14C6C93ULL * c0, y = (unsigned __int128)0xCA5A826395121157ULL * c2;
            c0 = (word)(y >> 64) ^ c1 ^ k0, c1 = (word)y, c2 = (word)(x >> 64) ^ c3 ^ k1, c3 = (word)x;
        }
        ((word *)a)[i] = c0 >> 12 | 0x3FF0000000000000ULL;
        ((word *)b)[i] = c1 >> 12 | 0x3FF0000000000000ULL;
    }
    *a -= 1.0;
    *b -= 1.0;
}

/* Add noise to the readings of both joints. */
static inline void add_noise(lanes *reading, double std, word stream, word lane, word step) {
    lanes a, b, sine, cosine;
    uniforms(stream, lane, step, &a, &b);
    lanes radius = std * root(-2.0 * log_lanes(1.0 - a));
    sincos_lanes(6.283185307179586 * b, &sine, &cosine);
    reading[0] += radius * cosine;
    reading[1] += radius * sine;
}

/* Inertia matrix (m11, m12, m22) and the torque left to accelerate it. */
static inline void load_on(const block *b, const lanes *rotor, const lanes *q, const lanes *v, const lanes *t, lanes *m, lanes *f) {
    lanes s1, c1, s2, c2;
    sincos_lanes(q[0], &s1, &c1);
    sincos_lanes(q[1], &s2, &c2);
    lanes h = b->p[2] * s2, g2 = b->p[4] * (c1 * c2 - s1 * s2);
    m[0] = b->p[0] + b->p[1] + 2.0 * b->p[2] * c2 + rotor[0];
    m[1] = b->p[1] + b->p[2] * c2;
    m[2] = b->p[1] + rotor[1];
    f[0] = t[0] + h * v[1] * (2.0 * v[0] + v[1]) - b->p[3] * c1 - g2;
    f[1] = t[1] - h * v[0] * v[0] - g2;
}

static inline void solve(const lanes *m, const lanes *f, lanes *a) {
    lanes scale = 1.0 / (m[0] * m[2] - m[1] * m[1]);
    a[0] = (m[2] * f[0] - m[1] * f[1]) * scale;
    a[1] = (m[0] * f[1] - m[1] * f[0]) * scale;
}

/* The nine cases of two coupled joints, each of which rests or slides either way; see fbl_gym/kernel/friction.py. */
static inline void resist(const lanes *m, const lanes *g, const lanes *bound, lanes *w, lanes *f) {
    lanes one = 0.0 * g[0] + 1.0, zero = 0.0 * g[0], scale = 1.0 / (m[0] * m[2] - m[1] * m[1]);
    lanes alone1 = shrink(g[0], bound[0]) / m[0], alone2 = shrink(g[1], bound[1]) / m[2];
    lanes left1 = g[0] - m[1] * alone2, left2 = g[1] - m[1] * alone1;
    whole rests1 = size_of(left1) <= bound[0], rests2 = size_of(left2) <= bound[1];
    lanes way1 = pick(left1 > 0.0, one, -one), way2 = pick(left2 > 0.0, one, -one);
    lanes h1 = g[0] - way1 * bound[0], h2 = g[1] - way2 * bound[1];
    lanes w1 = way1 * larger(way1 * (m[2] * h1 - m[1] * h2) * scale, zero);
    lanes w2 = way2 * larger(way2 * (m[0] * h2 - m[1] * h1) * scale, zero);
    w[0] = pick(rests1, zero, pick(rests2, alone1, w1));
    w[1] = pick(rests2, zero, pick(rests1, alone2, w2));
    f[0] = g[0] - m[0] * w[0] - m[1] * w[1];
    f[1] = g[1] - m[1] * w[0] - m[2] * w[1];
}

static inline lanes dry(const block *b, int i, lanes v, lanes drive) {
    return b->coulomb[i] + b->load[i] * size_of(drive) + b->stiction[i] * exp_lanes(-v * v / b->v_s[i]);
}

static inline lanes spring(const block *b, int i, lanes stretch, lanes rate) {
    lanes gap = 0.5 * b->backlash[i], zero = 0.0 * gap;
    lanes t = b->stiffness[i] * shrink(stretch, gap) + pick(size_of(stretch) >= gap, b->damping[i] * rate, zero);
    return pick((gap > 0.0) & (t * stretch < 0.0), zero, t);
}

/* Friction over a physics step: its torque f; 0 where a joint sticks throughout, and 0 where it ends the step at rest, else 1. */
static inline void hold(const block *b, int elastic, double h, const lanes *t, const lanes *drive, lanes *f, lanes *free, lanes *moves) {
    const lanes *v = elastic ? b->motor_v : b->v;
    lanes one = 0.0 * b->q[0] + 1.0, zero = 0.0 * b->q[0], m[3], g[2], left[2], bound[2], next[2];
    for (int i = 0; i < 2; i++) {
        bound[i] = h * dry(b, i, v[i], drive[i]);
        left[i] = t[i] - b->viscous[i] * v[i];
        if (elastic) left[i] -= spring(b, i, b->motor_q[i] - b->q[i], b->motor_v[i] - b->v[i]);
    }
    if (elastic) {
        for (int i = 0; i < 2; i++) {
            g[i] = b->rotor[i] * v[i] + h * left[i];
            next[i] = shrink(g[i], bound[i]);
            f[i] = (g[i] - next[i]) / h;
        }
    } else {
        load_on(b, b->rotor, b->q, v, left, m, g);
        g[0] = m[0] * v[0] + m[1] * v[1] + h * g[0];
        g[1] = m[1] * v[0] + m[2] * v[1] + h * g[1];
        resist(m, g, bound, next, f);
        f[0] /= h, f[1] /= h;
    }
    for (int i = 0; i < 2; i++) {
        whole rest = (next[i] == 0.0) & (bound[i] > 0.0);
        free[i] = pick(rest & (v[i] == 0.0), zero, one);
        moves[i] = pick(rest, zero, one);
    }
}

/* Derivative of a state under the torques t of the drives and the friction f that is held. */
static inline void held_slope(const block *b, int elastic, const lanes *x, const lanes *t, const lanes *f, const lanes *free, lanes *dx) {
    lanes m[3], u[2], g[2], none[2] = {0.0 * x[0], 0.0 * x[0]};
    for (int i = 0; i < 2; i++) {
        lanes v = x[elastic ? 6 + i : 2 + i];
        dx[i] = x[2 + i];
        u[i] = t[i] - b->viscous[i] * v - f[i];
        if (elastic) {
            lanes pull = spring(b, i, x[4 + i] - x[i], x[6 + i] - x[2 + i]);
            dx[4 + i] = x[6 + i];
            dx[6 + i] = free[i] * (u[i] - pull) / b->rotor[i];
            u[i] = pull - b->push[i];
        }
    }
    load_on(b, elastic ? none : b->rotor, x, x + 2, u, m, g);
    if (!elastic) g[0] *= free[0], g[1] *= free[1], m[1] *= free[0] * free[1];
    solve(m, g, dx + 2);
}

/* The acceleration at this instant, under friction. */
static inline void accelerate(const block *b, const lanes *t, const lanes *drive, lanes *a) {
    lanes zero = 0.0 * t[0], m[3], u[2], g[2], bound[2], f[2];
    for (int i = 0; i < 2; i++) {
        bound[i] = dry(b, i, b->v[i], drive[i]);
        u[i] = t[i] - b->viscous[i] * b->v[i] - pick(b->v[i] > 0.0, bound[i], pick(b->v[i] < 0.0, -bound[i], zero));
        bound[i] = pick(b->v[i] == 0.0, bound[i], zero);
    }
    load_on(b, b->rotor, b->q, b->v, u, m, g);
    resist(m, g, bound, a, f);
}

/* Torques of the drives at the start, the middle and the end of a physics step, after delay, lag and gain. */
static inline void drive(block *b, double substep, const lanes *decay, lanes *start, lanes *half, lanes *end) {
    for (int i = 0; i < 2; i++) {
        lanes target = pick(b->delay > substep, b->before[i], b->command[i]), gap = b->lagged[i] - target;
        b->lagged[i] = target + decay[2] * gap;
        start[i] = b->gain[i] * (target + decay[0] * gap);
        half[i] = b->gain[i] * (target + decay[1] * gap);
        end[i] = b->gain[i] * b->lagged[i];
    }
}

static inline void work(int elastic, const task *k, block *b, word lane, word step) {
    const int rows = elastic ? 8 : 4;
    const double h = k->h;
    lanes zero = 0.0 * b->q[0], one = zero + 1.0, start[2], half[2], end[2], decay[3] = {zero, zero, zero};
    lanes f[2], free[2], moves[2], *x = b->q;
    if (k->amplitude > 0.0 && step % (word)k->period == 0) {
        uniforms(0, lane, step, b->push, b->push + 1);
        for (int i = 0; i < 2; i++) b->push[i] = k->amplitude * (2.0 * b->push[i] - 1.0);
    }
    if (elastic) {  /* a rigid arm here has drives without lag */
        decay[0] = pick(b->lag > 0.0, one, zero);
        decay[2] = decay[0] * exp_lanes(-1.0 / larger(b->lag, zero + 1e-9));
        decay[1] = 0.25 * (6.0 * b->lag * (1.0 - decay[2]) - decay[0] - decay[2]);
    }
    for (int substep = 0; substep < k->substeps; substep++) {
        lanes k1[8], k2[8], k3[8], k4[8], y[8];
        if (elastic || substep == 0) drive(b, substep, decay, start, half, end);
        const lanes now[2] = {end[0], end[1]};
        if (!elastic && substep == 0)
            for (int i = 0; i < 2; i++) start[i] = half[i] = end[i] -= b->push[i];
        hold(b, elastic, h, start, now, f, free, moves);
        held_slope(b, elastic, x, start, f, free, k1);
        for (int i = 0; i < rows; i++) y[i] = x[i] + 0.5 * h * k1[i];
        held_slope(b, elastic, y, half, f, free, k2);
        for (int i = 0; i < rows; i++) y[i] = x[i] + 0.5 * h * k2[i];
        held_slope(b, elastic, y, half, f, free, k3);
        for (int i = 0; i < rows; i++) y[i] = x[i] + h * k3[i];
        held_slope(b, elastic, y, end, f, free, k4);
        for (int i = 0; i < rows; i++) x[i] += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        for (int i = 0; i < 2; i++) x[rows - 2 + i] *= moves[i];
    }
    for (int i = 0; i < 2; i++) {
        b->before[i] = b->command[i];
        b->reading[i] = b->q[i];
        b->reading[2 + i] = b->v[i];
    }
    if (!elastic) accelerate(b, end, b->command, b->reading + 4);
    for (int i = 0; i < 3; i++)
        if (k->noise[i] > 0.0) add_noise(b->reading + 2 * i, k->noise[i], 1 + i, lane, step);
    for (int i = 0; i < 2; i++) {
        if (k->quantum > 0.0) {
            b->reading[i] = lower(b->reading[i] / k->quantum + 0.5) * k->quantum;
            b->reading[2 + i] = (b->reading[i] - b->encoder[i]) / (h * k->substeps);
            b->encoder[i] = b->reading[i];
        }
        b->reading[i] = limit(b->reading[i], 25.0);
        b->reading[2 + i] = limit(b->reading[2 + i], 200.0);
        b->reading[4 + i] = limit(b->reading[4 + i], 1e5);
    }
}

/* Advance all arms by a control step; `step` counts them. */
void work_rigid(const task *k, block *b, long blocks, long step) {
    for (long i = 0; i < blocks; i++) work(0, k, b + i, LANES * i, step);
}

void work_elastic(const task *k, block *b, long blocks, long step) {
    for (long i = 0; i < blocks; i++) work(1, k, b + i, LANES * i, step);
}
