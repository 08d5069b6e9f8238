/* The winch of own_machine.py as an FMU for model exchange: FMI 2, or FMI 3 with -DFMI3. A test compiles it. */
#include <math.h>
#include <stdlib.h>
typedef struct { double x[2], u, p[5]; } Winch; /* p: inertia, damping, spring, weight, load; references 0..4, u 5, x 6, 7 */
static const double start[5] = {0.020, 0.05, 0.8, 0.30, 0.0};
static Winch *fresh(void) { Winch *w = calloc(1, sizeof(Winch)); for (int i = 0; i < 5; i++) w->p[i] = start[i]; return w; }
static int set(Winch *w, const unsigned *r, size_t n, const double *v) {
  for (size_t i = 0; i < n; i++) {
    if (r[i] < 5) w->p[r[i]] = v[i]; else if (r[i] == 5) w->u = v[i]; else if (r[i] < 8) w->x[r[i] - 6] = v[i]; else return 3;
  }
  return 0;
}
static int slopes(const Winch *w, double *d) {
  const double *x = w->x, *p = w->p;
  d[0] = x[1]; d[1] = (w->u - p[1] * x[1] - p[2] * x[0] - p[3] * sin(x[0])) / (p[0] + 0.03 * p[4]);
  return p[0] > 0 ? 0 : 3;
}
static int again(Winch *w) { Winch *f = fresh(); *w = *f; free(f); return 0; }
static int states(Winch *w, const double *x) { w->x[0] = x[0]; w->x[1] = x[1]; return 0; }
#ifdef FMI3
typedef _Bool B;
void *fmi3InstantiateModelExchange(const char *a, const char *t, const char *r, B v, B l, void *e, void *m) { return fresh(); }
void fmi3FreeInstance(Winch *w) { free(w); }
int fmi3Reset(Winch *w) { return again(w); }
int fmi3EnterInitializationMode(Winch *w, B td, double t, double s, B sd, double e) { return 0; }
int fmi3ExitInitializationMode(Winch *w) { return 0; }
int fmi3UpdateDiscreteStates(Winch *w, B *a, B *b, B *c, B *d, B *e, double *n) { *a = *b = *c = *d = *e = 0; return 0; }
int fmi3EnterContinuousTimeMode(Winch *w) { return 0; }
int fmi3SetTime(Winch *w, double t) { return 0; }
int fmi3SetFloat64(Winch *w, const unsigned *r, size_t n, const double *v, size_t m) { return set(w, r, n, v); }
int fmi3SetContinuousStates(Winch *w, const double *x, size_t n) { return states(w, x); }
int fmi3GetContinuousStateDerivatives(Winch *w, double *d, size_t n) { return slopes(w, d); }
#else
typedef struct { int again, end, a, b, c; double next; } Event;
void *fmi2Instantiate(const char *a, int t, const char *g, const char *r, const void *f, int v, int l) { return fresh(); }
void fmi2FreeInstance(Winch *w) { free(w); }
int fmi2Reset(Winch *w) { return again(w); }
int fmi2SetupExperiment(Winch *w, int d, double tol, double t, int s, double e) { return 0; }
int fmi2EnterInitializationMode(Winch *w) { return 0; }
int fmi2ExitInitializationMode(Winch *w) { return 0; }
int fmi2NewDiscreteStates(Winch *w, Event *e) { e->again = e->end = e->a = e->b = e->c = 0; return 0; }
int fmi2EnterContinuousTimeMode(Winch *w) { return 0; }
int fmi2SetTime(Winch *w, double t) { return 0; }
int fmi2SetReal(Winch *w, const unsigned *r, size_t n, const double *v) { return set(w, r, n, v); }
int fmi2SetContinuousStates(Winch *w, const double *x, size_t n) { return states(w, x); }
int fmi2GetDerivatives(Winch *w, double *d, size_t n) { return slopes(w, d); }
#endif
