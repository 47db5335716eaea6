/* Runs an exported header on the host: raw doubles in, raw doubles out; or line by line on stdin and stdout. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include TABLE

static double seconds(void)
{
  struct timespec t;
  timespec_get(&t, TIME_UTC);
  return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void correct(const double *in, double *out)
{
  level_real f[2];
  level_correct((level_real)in[0], (level_real)in[1], (level_real)in[2], f);
  out[0] = (double)f[0];
  out[1] = (double)f[1];
}

static void tilt(const double *in, double *out)
{
  level_real t[2];
  level_tilt((level_real)in[0], (level_real)in[1], t);
  out[0] = (double)t[0];
  out[1] = (double)t[1];
}

static void integer(const double *in, double *out)
{
  int32_t f[2];
  const int32_t up = in[2] != in[2] ? LEVEL_OUTSIDE : (int32_t)in[2];
  const unsigned outside = level_correct_i((int32_t)in[0], (int32_t)in[1], up, f);
  out[0] = outside & 1u ? (double)NAN : (double)f[0];
  out[1] = outside & 2u ? (double)NAN : (double)f[1];
}

static void rounded(const double *in, double *out)
{
  out[0] = (double)level_rounded(0, (level_real)in[0]);
  out[1] = (double)level_rounded(1, (level_real)in[1]);
}

static void interpolated(const double *in, double *out)
{
  out[0] = (double)level_interpolated(0, (level_real)in[0]);
  out[1] = (double)level_interpolated(1, (level_real)in[1]);
}

static void rounded_mdeg(const double *in, double *out)
{
  out[0] = (double)level_rounded_mdeg(0, (int32_t)in[0]);
  out[1] = (double)level_rounded_mdeg(1, (int32_t)in[1]);
}

static void interpolated_mdeg(const double *in, double *out)
{
  out[0] = (double)level_interpolated_mdeg(0, (int32_t)in[0]);
  out[1] = (double)level_interpolated_mdeg(1, (int32_t)in[1]);
}

typedef void (*work)(const double *, double *);
static const struct { const char *name; work run; } works[] = {
  {"correct", correct}, {"tilt", tilt}, {"integer", integer}, {"rounded", rounded}, {"interpolated", interpolated},
  {"rounded_mdeg", rounded_mdeg}, {"interpolated_mdeg", interpolated_mdeg}
};

/* samples "time_s,f_x,f_y" by line; answers "tilt_x,tilt_y" by line */
static int live(void)
{
  char line[256];
  while (fgets(line, sizeof line, stdin)) {
    double t, in[3] = {0, 0, (double)NAN}, out[2];
    if (sscanf(line, "%lf,%lf,%lf", &t, &in[0], &in[1]) != 3)
      return 1;
    tilt(in, out);
    printf("%.17g,%.17g\n", out[0], out[1]);
    fflush(stdout);
  }
  return 0;
}

int main(int argc, char **argv)
{
  double *in, *out, start, took = 1e9;
  long n, k;
  size_t w;
  int repeat;
  work run = NULL;
  FILE *file;
  if (argc == 1)
    return live();
  for (w = 0; w < sizeof works / sizeof *works; w++)
    if (!strcmp(argv[1], works[w].name))
      run = works[w].run;
  n = atol(argv[2]);
  in = malloc((size_t)n * 3 * sizeof *in);
  out = calloc((size_t)n * 2, sizeof *out);
  file = fopen(argv[3], "rb");
  if (!run || !in || !out || !file || fread(in, 3 * sizeof *in, (size_t)n, file) != (size_t)n)
    return 1;
  fclose(file);
  for (repeat = 0; repeat < 3; repeat++) { /* the best of three: others use the machine too */
    start = seconds();
    for (k = 0; k < n; k++)
      run(in + 3 * k, out + 2 * k);
    start = seconds() - start;
    took = start < took ? start : took;
  }
  fprintf(stderr, "%.3f\n", 1e9 * took / (double)n);
  file = fopen(argv[4], "wb");
  if (!file || fwrite(out, 2 * sizeof *out, (size_t)n, file) != (size_t)n)
    return 1;
  return fclose(file);
}
