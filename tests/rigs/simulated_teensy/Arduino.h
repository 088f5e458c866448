// As much of Teensy's core as the sketch uses, after its public headers; what stands behind it is in main.cpp.

#pragma once

#include <stddef.h>
#include <stdint.h>

#define OUTPUT 1
#define LOW 0
#define HIGH 1

// On every Teensy with a pad's worth of analogue pins, A0 to A9 are pins 14 to 23.
enum { A0 = 14, A1, A2, A3, A4, A5, A6, A7, A8, A9 };

void pinMode(uint8_t pin, uint8_t mode);
void digitalWrite(uint8_t pin, uint8_t value);
int analogRead(uint8_t pin);
void analogReadResolution(unsigned int bits);
void delayMicroseconds(uint32_t us);
uint32_t millis();

class IntervalTimer {
 public:
  bool begin(void (*function)(), float period_us);
};

struct UsbSerial {
  void begin(long baud);
  size_t write(const uint8_t *bytes, size_t size);
};

extern UsbSerial Serial;
