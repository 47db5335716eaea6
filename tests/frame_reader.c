/* Reads the frames of `tiltcal serve` on standard input and corrects a triad by an exported header.
 *
 * cc -DHEADER='"imu.h"' frame_reader.c -lm; ./a.out COLUMNS FIRST < frames
 * COLUMNS: numbers in a frame; FIRST: place of the triad's x. Prints counter, time and the corrected
 * triad of each frame, and what was lost or damaged.
 */
#include HEADER
#include <inttypes.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { HEAD = 16, TAIL = 4, MOST = 64 };

static uint32_t crc32(const unsigned char *bytes, size_t n)
{
  uint32_t crc = 0xFFFFFFFFu;
  for (size_t i = 0; i < n; i++) {
    crc ^= bytes[i];
    for (int bit = 0; bit < 8; bit++) crc = (crc >> 1) ^ (0xEDB88320u & (0u - (crc & 1u)));
  }
  return ~crc;
}

static uint64_t little(const unsigned char *bytes, int n)
{
  uint64_t value = 0;
  while (n-- > 0) value = value << 8 | bytes[n];
  return value;
}

static double number(const unsigned char *bytes)
{
  uint64_t bits = little(bytes, 8);
  double value;
  memcpy(&value, &bits, sizeof value);
  return value;
}

int main(int count, char **words)
{
  const int columns = count > 1 ? atoi(words[1]) : 0, first = count > 2 ? atoi(words[2]) : 0;
  const size_t size = (size_t)(HEAD + 8 * columns + TAIL);
  unsigned char frame[HEAD + 8 * MOST + TAIL];
  uint32_t expected = 0;
  int begun = 0;
  if (columns < 3 || columns > MOST || first < 0 || first > columns - 3) return 2;
  while (fread(frame, 1, size, stdin) == size) {
    if (memcmp(frame, "TCF1", 4) || crc32(frame, size - TAIL) != little(frame + size - TAIL, 4)) {
      puts("damaged");
      continue;
    }
    const uint32_t counter = (uint32_t)little(frame + 4, 4);
    if (begun && counter != expected) printf("lost %" PRIu32 "\n", counter - expected);
    begun = 1;
    expected = counter + 1;
    imu_real reading[3], corrected[3];
    for (int i = 0; i < 3; i++) reading[i] = (imu_real)number(frame + HEAD + 8 * (first + i));
    imu_accel(reading, corrected);
    printf("%" PRIu32 " %.17g %.17g %.17g %.17g\n", counter, number(frame + 8), (double)corrected[0],
           (double)corrected[1], (double)corrected[2]);
  }
  return 0;
}
