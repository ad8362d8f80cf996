/* The held vehicle in Dryden turbulence under a law of order ORDER, for W flights at once: the yardstick of the compiled
 * Python loops. The arithmetic is theirs, operation by operation, so that all bits are equal. It is built without
 * contraction of products and sums. W = 1 is a plain scalar program; W = 32 lets the compiler use SIMD. Constants and
 * states are rows of W numbers in the order of firmware_model.sim.layout.
 */
#include <math.h>
#include <stdint.h>
#include <string.h>

#define LANES for (int w = 0; w < W; w++)
#define ALIGNED __attribute__((aligned(64)))

enum { GUST_STREAM = 1, GYRO_STREAM = 2 };

/* Philox4x32-10 (Salmon, Moraes, Dror, Shaw 2011); a double below 2^52 is made from its bits, which SIMD can do. */
static inline void philox(uint32_t sample, uint32_t block, uint32_t seed, uint32_t stream, uint32_t out[4])
{
    uint32_t a = sample, b = block, c = 0, d = 0, j = seed, k = stream;
    for (int i = 0; i < 10; i++) {
        uint64_t low = (uint64_t)a * 0xD2511F53u, high = (uint64_t)c * 0xCD9E8D57u;
        a = (uint32_t)(high >> 32) ^ b ^ j;
        b = (uint32_t)high;
        c = (uint32_t)(low >> 32) ^ d ^ k;
        d = (uint32_t)low;
        j += 0x9E3779B9u;
        k += 0xBB67AE85u;
    }
    out[0] = a, out[1] = b, out[2] = c, out[3] = d;
}

static inline double from_bits(uint64_t bits)
{
    double x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static inline uint64_t to_bits(double x)
{
    uint64_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

/* Estrin's scheme for eight coefficients, from the lowest power on. */
static inline double octave(double x, const double a[8])
{
    double y = x * x;
    double low = (a[0] + a[1] * x) + (a[2] + a[3] * x) * y, high = (a[4] + a[5] * x) + (a[6] + a[7] * x) * y;
    return low + high * (y * y);
}

/* fdlibm's e_log.c on a positive normal number. */
static inline double natural_log(double x)
{
    static const double a[8] = {
        6.666666666666735130e-01, 3.999999999940941908e-01, 2.857142874366239149e-01, 2.222219843214978396e-01,
        1.818357216161805012e-01, 1.531383769920937332e-01, 1.479819860511658591e-01, 0.0,
    };
    uint64_t bits = to_bits(x);
    uint64_t biased = (bits - 0x3FE6A09E667F3BCDu + (1024ull << 52)) >> 52;
    double k = from_bits(biased | 0x4330000000000000u) - 4503599627371520.0;
    double f = from_bits(bits - ((biased - 1024) << 52)) - 1.0, s = f / (2.0 + f), z = s * s;
    double r = z * octave(z, a), half = 0.5 * f * f;
    return k * 6.93147180369123816490e-01 - ((half - (s * (half + r) + k * 1.90821492927058770002e-10)) - f);
}

/* Wichura's AS 241, PPND16. */
static inline double central(double u)
{
    static const double n[8] = {
        3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3, 1.3731693765509461125e4,
        4.5921953931549871457e4, 6.7265770927008700853e4, 3.3430575583588128105e4, 2.5090809287301226727e3,
    }, d[8] = {
        1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3,
        2.1213794301586595867e4, 3.9307895800092710610e4, 2.8729085735721942674e4, 5.2264952788528545610e3,
    };
    double q = u - 0.5, r = 0.180625 - q * q;
    return q * octave(r, n) / octave(r, d);
}

static inline double outer(double u)
{
    static const double n[8] = {
        1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0, 3.64784832476320460504e0,
        1.27045825245236838258e0, 2.41780725177450611770e-1, 2.27238449892691845833e-2, 7.74545014278341407640e-4,
    }, d[8] = {
        1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1,
        1.48103976427480074590e-1, 1.51986665636164571966e-2, 5.47593808499534494600e-4, 1.05075007164441684324e-9,
    };
    double t = sqrt(-natural_log(u < 1.0 - u ? u : 1.0 - u)) - 1.6, x = octave(t, n) / octave(t, d);
    return u < 0.5 ? -x : x;
}

static inline double uniform(uint32_t word)
{
    return (from_bits((uint64_t)word | 0x4330000000000000u) - 4503599627370496.0 + 0.5) * 0x1p-32;
}

static inline int is_outer(double u)
{
    return fabs(u - 0.5) > 0.425;
}

/* Twelve numbers a flight: four for the gyro, eight for the air. */
static void draw(const uint32_t *seed, uint32_t sample, double u[12][W])
{
    static const uint32_t stream[3] = {GYRO_STREAM, GUST_STREAM, GUST_STREAM}, block[3] = {0, 0, 1};
    for (int i = 0; i < 3; i++)
        LANES {
            uint32_t out[4];
            philox(sample, block[i], seed[w], stream[i], out);
            for (int j = 0; j < 4; j++)
                u[4 * i + j][w] = uniform(out[j]);
        }
}

/* One number in seven lies outside the centre; several flights place these side by side. */
static void normals(const double *u, double *n)
{
#if W == 1
    for (int i = 0; i < 12; i++)
        n[i] = is_outer(u[i]) ? outer(u[i]) : central(u[i]);
#else
    static double far[12 * W + W] ALIGNED;
    static int place[12 * W];
    int count = 0;
    for (int i = 0; i < 12 * W; i++)
        n[i] = central(u[i]);
    for (int i = 0; i < 12 * W; i++) {
        far[count] = u[i], place[count] = i;
        count += is_outer(u[i]);
    }
    LANES far[count + w] = 0.5;
    for (int i = 0; i < count; i += W)
        LANES far[i + w] = outer(far[i + w]);
    for (int i = 0; i < count; i++)
        n[place[i]] = far[i];
#endif
}

static inline void sin_cos(double x, double *sine, double *cosine)
{
    double n = floor(x * 0.6366197723675814 + 0.5);
    double r = ((x - n * 1.57079632673412561417e00) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
    double z = r * r;
    double s = r + r * z * (-1.66666666666666324348e-01 + z * (8.33333333332248946124e-03
        + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06
        + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10)))));
    double c = 1.0 - 0.5 * z + z * z * (4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03
        + z * (2.48015872894767294178e-05 + z * (-2.75573143513906633035e-07
        + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)))));
    double quadrant = n - 4.0 * floor(0.25 * n);
    int odd = (quadrant == 1.0) | (quadrant == 3.0);
    double a = odd ? c : s, b = odd ? s : c;
    *sine = quadrant >= 2.0 ? -a : a;
    *cosine = (quadrant == 1.0) | (quadrant == 2.0) ? -b : b;
}

typedef struct {
    double k1, k2, k3, damping_x, damping_y, damping_z;
} Params;

typedef struct {
    double x, y, z;
} Vector;

static inline Vector rate(Params c, Vector omega, Vector turn)
{
    double p = omega.x, q = omega.y, r = omega.z;
    return (Vector){
        c.k1 * q * r + (turn.x - c.damping_x * p),
        c.k2 * r * p + (turn.y - c.damping_y * q),
        c.k3 * p * q + (turn.z - c.damping_z * r),
    };
}

typedef struct {
    double w, x, y, z;
} Quaternion;

static inline Quaternion twice_rate(Quaternion a, Vector omega)
{
    double p = omega.x, q = omega.y, r = omega.z;
    return (Quaternion){
        -(a.x * p + a.y * q + a.z * r),
        a.w * p + a.y * r - a.z * q,
        a.w * q + a.z * p - a.x * r,
        a.w * r + a.x * q - a.y * p,
    };
}

static inline Vector times(double h, Vector a)
{
    return (Vector){h * a.x, h * a.y, h * a.z};
}

static inline Vector plus(Vector a, Vector b)
{
    return (Vector){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline Quaternion times4(double h, Quaternion a)
{
    return (Quaternion){h * a.w, h * a.x, h * a.y, h * a.z};
}

static inline Quaternion plus4(Quaternion a, Quaternion b)
{
    return (Quaternion){a.w + b.w, a.x + b.x, a.y + b.y, a.z + b.z};
}

typedef struct {
    Quaternion q;
    Vector omega;
} Body;

/* A step under the angular accelerations at its start, in its middle and at its end. */
static inline Body runge_kutta(Params c, Body x, Vector start, Vector middle, Vector end, double dt)
{
    Vector a = times(0.5 * dt, rate(c, x.omega, start)), second = plus(x.omega, a);
    Vector b = times(0.5 * dt, rate(c, second, middle)), third = plus(x.omega, b);
    Vector e = times(dt, rate(c, third, middle)), fourth = plus(x.omega, e);
    Vector f = times(0.5 * dt, rate(c, fourth, end));
    Quaternion i = times4(0.25 * dt, twice_rate(x.q, x.omega));
    Quaternion j = times4(0.25 * dt, twice_rate(plus4(x.q, i), second));
    Quaternion k = times4(0.5 * dt, twice_rate(plus4(x.q, j), third));
    Quaternion l = times4(0.25 * dt, twice_rate(plus4(x.q, k), fourth));
    Quaternion q = plus4(x.q, times4(1.0 / 3.0, plus4(plus4(plus4(i, plus4(j, j)), k), l)));
    Vector omega = plus(x.omega, times(1.0 / 3.0, plus(plus(plus(a, plus(b, b)), e), f)));
    return (Body){times4(1.0 / sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z), q), omega};
}

static inline Vector approach(double lag, Vector given, Vector command)
{
    return (Vector){
        command.x + lag * (given.x - command.x),
        command.y + lag * (given.y - command.y),
        command.z + lag * (given.z - command.z),
    };
}

static inline Vector turn(Vector outside, Vector torque, Vector inverse)
{
    return (Vector){
        outside.x + torque.x * inverse.x,
        outside.y + torque.y * inverse.y,
        outside.z + torque.z * inverse.z,
    };
}

static inline double clamped(double x, double limit)
{
    double low = x < -limit ? -limit : x;
    return low > limit ? limit : low;
}

/* States, measurements and references, Euler rates, torque excess, rate excess, a zero. */
enum { RATES = ORDER + 9, CUT = ORDER + 12, OVER = ORDER + 15, NUMBERS = ORDER + 19 };
static double z[NUMBERS][W] ALIGNED, next[ORDER][W] ALIGNED;

static inline void sum(const double *terms, int begin, int end, double *total)
{
    LANES total[w] = 0.0;
    for (int t = begin; t < end; t += 4) {
        const double *term = terms + 2 * t;
        double *a = z[(int)term[0]], *b = z[(int)term[2]], *c = z[(int)term[4]], *d = z[(int)term[6]];
        LANES total[w] = total[w] + term[1] * a[w] + term[3] * b[w] + term[5] * c[w] + term[7] * d[w];
    }
}

/* The rates commanded from attitude, less what is over their limits; returns the end of their terms. */
static int limit_rates(const int64_t *ends, const double *terms, const double *limits, const double *angles)
{
    int begin = 0, over = 0;
    for (int i = 0; i < 3; begin = ends[i++]) {
        sum(terms, begin, ends[i], z[OVER + i]);
        LANES over |= !(fabs(z[OVER + i][w]) <= limits[i] && fabs(z[i][w]) <= angles[i]);
    }
    if (!over) {
        memset(z[OVER], 0, 3 * sizeof z[OVER]);
        return begin;
    }
    LANES {
        double *s[3] = {&z[OVER][w], &z[OVER + 1][w], &z[OVER + 2][w]};
        double p = clamped(*s[0], limits[0]), q = clamped(*s[1], limits[1]), r = clamped(*s[2], limits[2]);
        double sin_phi, cos_phi, sin_theta, cos_theta;
        sin_cos(z[0][w] - clamped(z[0][w], angles[0]), &sin_phi, &cos_phi);
        sin_cos(z[1][w] - clamped(z[1][w], angles[1]), &sin_theta, &cos_theta);
        double across = cos_theta * r;
        *s[0] = p - sin_theta * r - *s[0];
        *s[1] = cos_phi * q + sin_phi * across - *s[1];
        *s[2] = cos_phi * across - sin_phi * q - *s[2];
    }
    return begin;
}

/* A law with its exact kinematics and limited rates, as sums of its nonzero terms; `limits` are those of commands,
 * rates and attitude. */
static void law_step(const int64_t *ends, const double *terms, const double *limits, double u[3][W])
{
    int begin = limit_rates(ends, terms, limits + 3, limits + 6);
    ends += 3;
    for (int i = 0; i < 3; begin = ends[i++]) {
        double total[W] ALIGNED;
        sum(terms, begin, ends[i], total);
        LANES u[i][w] = clamped(total[w], limits[i]);
        LANES z[CUT + i][w] = u[i][w] - total[w];
    }
    LANES {
        double sin_phi, cos_phi, sin_theta, cos_theta;
        sin_cos(z[0][w], &sin_phi, &cos_phi);
        sin_cos(z[1][w], &sin_theta, &cos_theta);
        double floored = cos_theta >= 0.0 ? 0.05 : -0.05;
        cos_theta = fabs(cos_theta) < 0.05 ? floored : cos_theta;
        double psi_dot = (sin_phi * z[4][w] + cos_phi * z[5][w]) / cos_theta;
        z[RATES][w] = z[3][w] + sin_theta * psi_dot;
        z[RATES + 1][w] = cos_phi * z[4][w] - sin_phi * z[5][w];
        z[RATES + 2][w] = psi_dot;
    }
    for (int i = 0; i < ORDER; begin = ends[3 + i++])
        sum(terms, begin, ends[3 + i], next[i]);
    memcpy(z, next, sizeof next);
}

/* Flies W flights: `params` and `state` hold rows of W, `last` (7, W) becomes attitude and rates at the last sample,
 * `torque` (W) the sum of the squares of the commanded torques. */
void fly(int samples, int substeps, double dt, const double *params, double *state, const uint32_t *seed,
         const int64_t *ends, const double *terms, const double *limits, const double *limit, double *last,
         double *torque)
{
    static double u[3][W] ALIGNED, late[3][W] ALIGNED, drawn[12][W] ALIGNED, n[12][W] ALIGNED;
    static double gust[3][W] ALIGNED, body[10][W] ALIGNED, air[8][W] ALIGNED;
    memcpy(body, state + (X_BODY + 6) * W, sizeof body);
    memcpy(air, state + X_DRYDEN * W, sizeof air);
    memset(z, 0, sizeof z), memset(late, 0, sizeof late);
    LANES torque[w] = 0.0;
#define P(row) params[(row) * W + w]
#define DRY(i) P(DRYDEN + (i))
    for (int k = 0; k < samples; k++) {
        if (k == samples - 1)
            memcpy(last, body, 7 * sizeof body[0]);
        draw(seed, k, drawn);
        normals(drawn[0], n[0]);
        for (int i = 0; i < 3; i++)
            LANES {
                double rate = body[4 + i][w];
                double noisy = rate + P(GYRO + 2 + i) + (P(GYRO) + P(GYRO + 1) * fabs(rate)) * n[i][w];
                z[ORDER + i][w] = (float)clamped(noisy, P(GYRO + 5));
            }
        law_step(ends, terms, limits, u);
        for (int i = 0; i < 3; i++)
            LANES {
                double command = late[i][w] * limit[i];
                late[i][w] = clamped((float)(u[i][w] / limit[i]), 1.0);
                u[i][w] = command;
                torque[w] += command * command;
            }
        LANES {
            double v = DRY(16) * air[1][w] + DRY(17) * air[2][w], vertical = DRY(31) * air[4][w] + DRY(32) * air[5][w];
            double gain = P(GUST_GAIN);
            gust[0][w] = gain * v, gust[1][w] = -gain * air[0][w], gust[2][w] = P(GUST_GAIN + 1) * gain * vertical;
            double p = air[7][w], q = DRY(33) * (vertical - air[6][w]), r = DRY(18) * (v - air[3][w]);
            gust[0][w] = P(BODY + 7) * p + gust[0][w] * P(BODY + 4);
            gust[1][w] = P(BODY + 8) * q + gust[1][w] * P(BODY + 5);
            gust[2][w] = P(BODY + 9) * r + gust[2][w] * P(BODY + 6);
        }
        for (int step = 0; step < substeps; step++)
            LANES {
                Params c = {P(BODY + 1), P(BODY + 2), P(BODY + 3), P(BODY + 7), P(BODY + 8), P(BODY + 9)};
                Vector outside = {gust[0][w], gust[1][w], gust[2][w]}, command = {u[0][w], u[1][w], u[2][w]};
                Vector given = {body[7][w], body[8][w], body[9][w]}, inverse = {P(BODY + 4), P(BODY + 5), P(BODY + 6)};
                Vector middle = approach(P(BODY + 10), given, command), end = approach(P(BODY + 10), middle, command);
                body[7][w] = end.x, body[8][w] = end.y, body[9][w] = end.z;
                Body x = {{body[0][w], body[1][w], body[2][w], body[3][w]}, {body[4][w], body[5][w], body[6][w]}};
                x = runge_kutta(c, x, turn(outside, given, inverse), turn(outside, middle, inverse),
                                turn(outside, end, inverse), dt);
                body[0][w] = x.q.w, body[1][w] = x.q.x, body[2][w] = x.q.y, body[3][w] = x.q.z;
                body[4][w] = x.omega.x, body[5][w] = x.omega.y, body[6][w] = x.omega.z;
            }
        LANES {
            const double *m = &n[4][w];
#define N(i) m[(i) * W]
            double v1 = air[1][w], v2 = air[2][w], v3 = air[3][w], w1 = air[4][w], w2 = air[5][w], w3 = air[6][w];
            air[0][w] = DRY(0) * air[0][w] + DRY(1) * N(0);
            air[1][w] = DRY(4) * v1 + DRY(10) * N(1);
            air[2][w] = DRY(5) * v1 + DRY(6) * v2 + DRY(11) * N(1) + DRY(12) * N(2);
            air[3][w] = DRY(7) * v1 + DRY(8) * v2 + DRY(9) * v3 + DRY(13) * N(1) + DRY(14) * N(2) + DRY(15) * N(3);
            air[4][w] = DRY(19) * w1 + DRY(25) * N(4);
            air[5][w] = DRY(20) * w1 + DRY(21) * w2 + DRY(26) * N(4) + DRY(27) * N(5);
            air[6][w] = DRY(22) * w1 + DRY(23) * w2 + DRY(24) * w3 + DRY(28) * N(4) + DRY(29) * N(5) + DRY(30) * N(6);
            air[7][w] = DRY(2) * air[7][w] + DRY(3) * N(7);
        }
    }
}
