/* An Arduino Mega 2560 that is not there, wired to a pad that is not there: simavr runs the sketch.
 *
 * simulated_mega SKETCH.elf PICTURES ROWS COLUMNS SECONDS
 *
 * PICTURES: uint16 millivolts (pictures, ROWS, COLUMNS), the voltage on each analogue pin while that row's pin
 * is low and all others are driven high. The n-th scan is given the n-th picture, and so on round. What the
 * sketch sends on its serial port goes to standard output. It ends after SECONDS of the board's time with one
 * line of JSON on standard error, or at once, with exit code 1, when the sketch reads an analogue pin while
 * the rows are driven in any other way. It runs as fast as it can.
 */

#define _POSIX_C_SOURCE 199309L

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "avr_adc.h"
#include "avr_ioport.h"
#include "avr_uart.h"
#include "sim_avr.h"
#include "sim_elf.h"

#define CLOCK_HZ 16000000
#define MAX_SCANS 4096

/* simavr 1.6 knows all sixteen analogue pins but keeps the voltages of eight: A8 to A15 are given to it as A0
 * to A7, and bit 5 of the multiplexer, in ADCSRB, tells which of the two is meant. */
#define KEPT_VOLTAGES 8
#define ADCSRB 0x7B
#define MUX5 3

/* The Mega's digital pins 2 to 11, where the wiring diagram has the rows. */
static const struct { char port; uint8_t bit; } ROW_PINS[] = {
    {'E', 4}, {'E', 5}, {'G', 5}, {'E', 3}, {'H', 3}, {'H', 4}, {'H', 5}, {'H', 6}, {'B', 4}, {'B', 5},
};

static avr_t *avr;
static avr_irq_t *adc_inputs;
static uint16_t *pictures;
static int rows, columns, picture_count;

static int scans;
static avr_cycle_count_t scan_began[MAX_SCANS], scan_ended[MAX_SCANS], sent[MAX_SCANS];
static avr_cycle_count_t row_switched, least_settling = UINT64_MAX;
static int row_before = -1;

static void fail(const char *what) {
    fprintf(stderr, "simulated_mega: %s\n", what);
    exit(1);
}

/* simavr's own words would go to standard output, among the frames. */
static void log_to_standard_error(avr_t *board, const int level, const char *format, va_list values) {
    (void)board, (void)level;
    vfprintf(stderr, format, values);
}

/* The row that is low while all others are driven high; -1 when the rows are driven in any other way. */
static int low_row(void) {
    int low = -1;
    for (int row = 0; row < rows; row++) {
        avr_ioport_state_t state;
        avr_ioctl(avr, AVR_IOCTL_IOPORT_GETSTATE(ROW_PINS[row].port), &state);
        if (!(state.ddr >> ROW_PINS[row].bit & 1)) return -1;
        if (state.port >> ROW_PINS[row].bit & 1) continue;
        if (low >= 0) return -1;
        low = row;
    }
    return low;
}

static void on_row_pin(avr_irq_t *irq, uint32_t value, void *parameter) {
    (void)irq, (void)value, (void)parameter;
    row_switched = avr->cycle;
}

static void on_conversion(avr_irq_t *irq, uint32_t value, void *parameter) {
    (void)irq, (void)parameter;
    union { uint32_t value; avr_adc_mux_t mux; } trigger = {value};
    int kept = trigger.mux.src;
    int column = kept + (avr->data[ADCSRB] >> MUX5 & 1) * KEPT_VOLTAGES;
    int row = low_row();
    if (row < 0) fail("a column was read while not exactly one row was low and all others were driven high");
    if (column >= columns) fail("an analogue pin was read that is not a column's");
    if (row != row_before) {
        if (avr->cycle - row_switched < least_settling) least_settling = avr->cycle - row_switched;
        if (row == 0) {
            if (scans == MAX_SCANS) fail("more scans than there is room for");
            scan_began[scans++] = row_switched;
        }
        row_before = row;
    }
    scan_ended[scans - 1] = avr->cycle;
    int picture = (scans - 1) % picture_count;
    avr_raise_irq(adc_inputs + kept, pictures[(picture * rows + row) * columns + column]);
}

static void on_byte(avr_irq_t *irq, uint32_t value, void *parameter) {
    (void)irq, (void)parameter;
    if (scans > 0) sent[scans - 1] = avr->cycle;
    uint8_t byte = value;
    if (write(STDOUT_FILENO, &byte, 1) != 1) fail("what the sketch sends cannot be written");
}

static void read_pictures(const char *path) {
    size_t size = (size_t)rows * columns * sizeof *pictures;
    FILE *file = fopen(path, "rb");
    if (!file) fail("the pictures cannot be read");
    fseek(file, 0, SEEK_END);
    picture_count = ftell(file) / size;
    rewind(file);
    pictures = malloc(picture_count * size);
    if (picture_count == 0 || fread(pictures, size, picture_count, file) != (size_t)picture_count)
        fail("the pictures are cut off");
    fclose(file);
}

static avr_adc_t *adc(void) {
    for (avr_io_t *io = avr->io_port; io; io = io->next)
        if (strcmp(io->kind, "adc") == 0) return (avr_adc_t *)io;
    fail("the simulated board has no analogue pins");
    return NULL;
}

static void connect(void) {
    for (int kept = 0; kept < KEPT_VOLTAGES; kept++) adc()->muxmode[(1 << 5) + kept].src = kept;
    for (int row = 0; row < rows; row++)
        avr_irq_register_notify(
            avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(ROW_PINS[row].port), ROW_PINS[row].bit), on_row_pin, NULL);
    adc_inputs = avr_io_getirq(avr, AVR_IOCTL_ADC_GETIRQ, 0);
    avr_irq_register_notify(adc_inputs + ADC_IRQ_OUT_TRIGGER, on_conversion, NULL);
    uint32_t flags = 0;
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &flags);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), on_byte, NULL);
}

static double ms(avr_cycle_count_t cycles) { return cycles * 1e3 / CLOCK_HZ; }

int main(int count, char **arguments) {
    if (count < 6) fail("usage: simulated_mega SKETCH.elf PICTURES ROWS COLUMNS SECONDS");
    rows = atoi(arguments[3]);
    columns = atoi(arguments[4]);
    read_pictures(arguments[2]);

    avr_global_logger_set(log_to_standard_error);
    elf_firmware_t sketch = {0};
    if (elf_read_firmware(arguments[1], &sketch) != 0) fail("the sketch cannot be read");
    avr = avr_make_mcu_by_name("atmega2560");
    avr_init(avr);
    avr_load_firmware(avr, &sketch);
    avr->frequency = CLOCK_HZ;
    avr->vcc = avr->avcc = avr->aref = 5000;
    connect();

    avr_cycle_count_t end = atof(arguments[5]) * CLOCK_HZ;
    while (avr->cycle < end) {
        int state = avr_run(avr);
        if (state == cpu_Done || state == cpu_Crashed) fail("the sketch crashed");
    }
    if (scans == 0) fail("the sketch never read the pad");

    fprintf(stderr, "{\"least_settling_us\":%.1f,\"began_ms\":[", ms(least_settling) * 1e3);
    for (int scan = 0; scan < scans; scan++) fprintf(stderr, "%s%.4f", scan ? "," : "", ms(scan_began[scan]));
    fprintf(stderr, "],\"scan_ms\":%.3f,\"until_sent_ms\":%.3f}\n", ms(scan_ended[0] - scan_began[0]),
            ms(sent[0] - scan_began[0]));
    return 0;
}
