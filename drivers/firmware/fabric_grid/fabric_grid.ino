// Reads a piezoresistive fabric pad 54 times a second and sends it to touchd as `fabric-grid` frames.
// Runs on an Arduino Mega 2560 and on a Teensy 4.0, 4.1 or 3.x; wiring and checks are in ../README.md.

#include <Arduino.h>

#include "frame.h"

// --- Settings ------------------------------------------------------------------------------------------

// The grid, 10x10 or 8x8. A smaller one leaves the last pins of the lists below unused.
#ifndef ROWS
#define ROWS 10
#endif
#ifndef COLUMNS
#define COLUMNS 10
#endif

// What touchd.yaml calls sensor.baud. A Teensy ignores it: its USB runs at full speed.
#ifndef BAUD
#define BAUD 512000
#endif

// From the top of the pad to the bottom, and from its left to its right, as seen by who touches it.
const uint8_t ROW_PINS[] = {2, 3, 4, 5, 6, 7, 8, 9, 10, 11};
const uint8_t COLUMN_PINS[] = {A0, A1, A2, A3, A4, A5, A6, A7, A8, A9};

// From the switching of a row to its first reading: ten time constants of 10 kilohms and 500 picofarads of
// fabric and wire, which leaves a twentieth of a count.
const uint16_t SETTLE_US = 50;

// The rate at which the model was trained; touchd takes 8 to 500, best 50 to 100.
const uint8_t FRAME_RATE_HZ = 54;

// --- The timer -----------------------------------------------------------------------------------------

// A late scan does not delay the next ones: the timer keeps running, and each frame carries its start time.
volatile bool scanIsDue = false;

#if defined(TEENSYDUINO)

IntervalTimer frameTimer;

void markDue() { scanIsDue = true; }

void startTimer() { frameTimer.begin(markDue, 1e6f / FRAME_RATE_HZ); }

#elif defined(__AVR_ATmega2560__)

// Timer 1 counts eighths of the clock and restarts at OCR1A: 54.0001 Hz of a true crystal.
const uint32_t TIMER_HZ = F_CPU / 8;
const uint32_t TICKS = (TIMER_HZ + FRAME_RATE_HZ / 2) / FRAME_RATE_HZ;
static_assert(TICKS <= 65536, "timer 1 cannot count that far: FRAME_RATE_HZ must be 31 or more");

ISR(TIMER1_COMPA_vect) { scanIsDue = true; }

void startTimer() {
  noInterrupts();
  TCCR1A = 0;
  TCCR1B = _BV(WGM12) | _BV(CS11);
  TCNT1 = 0;
  OCR1A = TICKS - 1;
  TIMSK1 = _BV(OCIE1A);
  interrupts();
}

#else
#error "choose Arduino Mega 2560 or a Teensy under Tools > Board"
#endif

// --- The pad -------------------------------------------------------------------------------------------

static_assert(ROWS <= sizeof ROW_PINS && COLUMNS <= sizeof COLUMN_PINS, "more taxels than pins: name the pins");

Frame<ROWS, COLUMNS> frame;

void setUpReading() {
#if defined(TEENSYDUINO)
  analogReadResolution(10);
#else
  // 250 kHz instead of 125: a scan takes half as long, so that all taxels are of nearly one moment.
  ADCSRA = (ADCSRA & ~(_BV(ADPS2) | _BV(ADPS1) | _BV(ADPS0))) | _BV(ADPS2) | _BV(ADPS1);
#endif
}

void setUpRows() {
  for (uint8_t row = 0; row < ROWS; row++) {
    pinMode(ROW_PINS[row], OUTPUT);
    digitalWrite(ROW_PINS[row], HIGH);
  }
}

// The row that is read is low; all others are driven high, never left open. Current through an open row would
// leak around a corner: three pressed corners of a rectangle would make the fourth look pressed.
void scan() {
  frame.begin(millis());
  for (uint8_t row = 0; row < ROWS; row++) {
    digitalWrite(ROW_PINS[row], LOW);
    delayMicroseconds(SETTLE_US);
    for (uint8_t column = 0; column < COLUMNS; column++) {
      frame.add(analogRead(COLUMN_PINS[column]));
    }
    digitalWrite(ROW_PINS[row], HIGH);
  }
  frame.end();
}

void setup() {
  Serial.begin(BAUD);
  setUpReading();
  setUpRows();
  startTimer();
}

// Sent only after the scan: however slow the line, no frame mixes two moments.
void loop() {
  if (!scanIsDue) return;
  scanIsDue = false;
  scan();
  Serial.write(frame.bytes, frame.SIZE);
}
