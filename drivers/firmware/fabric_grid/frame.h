// A frame of `fabric-grid`, byte by byte as it is sent; plain C++, for any board and any computer.
//
// Little-endian: FF FF FF FF, uint32 milliseconds since boot, rows x columns uint16 raw values (1023 is no
// pressure) row by row, one checksum byte: the low byte of the sum of all values and the time.

#pragma once

#include <stdint.h>

template <uint8_t rows, uint8_t columns>
struct Frame {
  static const uint16_t SIZE = 4 + 4 + 2 * rows * columns + 1;

  uint8_t bytes[SIZE];

  // Starts a frame whose scan begins at that time.
  void begin(uint32_t ms) {
    length = 0;
    sum = ms;
    for (uint8_t i = 0; i < 4; i++) put(0xFF);
    for (uint8_t shift = 0; shift < 32; shift += 8) put(ms >> shift);
  }

  // Adds the next raw value, 0 to 1023; call it rows x columns times.
  void add(uint16_t value) {
    sum += value;
    put(value);
    put(value >> 8);
  }

  // Completes the frame.
  void end() { put(sum); }

 private:
  uint16_t length;
  uint8_t sum;

  void put(uint8_t byte) { bytes[length++] = byte; }
};
