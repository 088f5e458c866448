// The sketch as a Teensy compiles it, on a Teensy that is not there: it runs on this computer, in made-up time.
//
// main SECONDS: what the sketch sends goes to standard output. The taxel in row r and column c reads
// 100 r + 10 c + s in scan s, each counted from 0 and s modulo 10, while row r is low and all others are
// driven high; any other way to drive the rows ends it with exit code 1.

#include "Arduino.h"

#include <stdio.h>
#include <stdlib.h>

#include "../../../drivers/firmware/fabric_grid/fabric_grid.ino"

UsbSerial Serial;

static double now_us, period_us, due_us;
static void (*on_timer)();
static bool is_output[24], is_high[24];
static unsigned int resolution;
static int scans = -1, row_before = -1;

static void fail(const char *what) {
  fprintf(stderr, "simulated_teensy: %s\n", what);
  exit(1);
}

static void pass(double us) {
  for (now_us += us; on_timer && now_us >= due_us; due_us += period_us) on_timer();
}

static int low_row() {
  int low = -1;
  for (int row = 0; row < ROWS; row++) {
    if (!is_output[2 + row]) return -1;
    if (is_high[2 + row]) continue;
    if (low >= 0) return -1;
    low = row;
  }
  return low;
}

void pinMode(uint8_t pin, uint8_t mode) { is_output[pin] = mode == OUTPUT; }

// As on a Teensy 4, what is written to an input is lost.
void digitalWrite(uint8_t pin, uint8_t value) {
  if (is_output[pin]) is_high[pin] = value;
}

void analogReadResolution(unsigned int bits) { resolution = bits; }

int analogRead(uint8_t pin) {
  int row = low_row();
  if (row < 0) fail("a column was read while not exactly one row was low and all others were driven high");
  if (pin < A0 || pin >= A0 + COLUMNS) fail("an analogue pin was read that is not a column's");
  if (resolution != 10) fail("values are not of 10 bits");
  if (row == 0 && row_before != 0) scans++;
  row_before = row;
  pass(20);
  return 100 * row + 10 * (pin - A0) + scans % 10;
}

void delayMicroseconds(uint32_t us) { pass(us); }

uint32_t millis() { return now_us / 1000; }

bool IntervalTimer::begin(void (*function)(), float period) {
  on_timer = function;
  period_us = period;
  due_us = now_us + period;
  return true;
}

void UsbSerial::begin(long) {}

size_t UsbSerial::write(const uint8_t *bytes, size_t size) { return fwrite(bytes, 1, size, stdout); }

int main(int, char **arguments) {
  setup();
  for (double end_us = atof(arguments[1]) * 1e6; now_us < end_us; pass(1)) loop();
}
