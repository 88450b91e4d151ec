// {{ origin }}
//
// The pins of the board's design in simulation: a UART with the design at its other end.
//
// Reads requests from stdin and writes replies to stdout, little endian:
//
//   request  uint32 symbols, uint32 bytes to wait for, uint32 bit times to wait at most, symbols
//   reply    uint32 clocks since the beginning, uint32 bytes, the bytes that the design sent
//
// A symbol is a uint16: 00bb the byte bb; 01bb the same with a stop bit of 0, as noise makes it;
// 02nn nn bit times of silence; 03nn the line low for nn clocks.

#include <cstdint>
#include <cstdio>
#include <memory>
#include <vector>

#include "Vpins.h"
#include "verilated.h"

#ifndef DIVIDER
#define DIVIDER {{ board.divider }}
#endif

namespace {

Vpins* design;
uint32_t clocks;
std::vector<uint8_t> received;

// The host's receiver: samples the middle of each bit that the design sends.
int bits_to_come, timer, shift;
bool before = true;

void sample(bool level) {
    if (bits_to_come == 0) {
        if (before && !level) {
            bits_to_come = 10;
            timer = DIVIDER / 2;
        }
    } else if (timer-- == 0) {
        timer = DIVIDER - 1;
        if (bits_to_come == 1) {
            if (level) received.push_back(static_cast<uint8_t>(shift));
        } else if (bits_to_come < 10) {
            shift = (shift >> 1) | (level ? 0x80 : 0);
        }
        --bits_to_come;
    }
    before = level;
}

void run(bool line, uint32_t count) {
    for (uint32_t k = 0; k < count; ++k) {
        design->rx = line;
        design->clk = 0;
        design->eval();
        design->clk = 1;
        design->eval();
        sample(design->tx);
        ++clocks;
    }
}

void send(uint16_t symbol) {
    const int kind = symbol >> 8, value = symbol & 0xFF;
    if (kind == 2) {
        for (int k = 0; k < value; ++k) run(true, DIVIDER);
    } else if (kind == 3) {
        run(false, static_cast<uint32_t>(value));
        run(true, 1);
    } else {
        run(false, DIVIDER);
        for (int k = 0; k < 8; ++k) run((value >> k) & 1, DIVIDER);
        run(kind == 0, DIVIDER);
        if (kind == 1) run(true, DIVIDER);
    }
}

bool read_all(void* into, size_t size) { return std::fread(into, 1, size, stdin) == size; }

}  // namespace

int main(int argc, char** argv) {
    Verilated::commandArgs(argc, argv);
    const auto made = std::make_unique<Vpins>();
    design = made.get();
{% if "button" in ports %}
    design->{{ ports.button }} = {{ 1 if board.button_low else 0 }};
{% endif %}
{% if "flash" in ports %}
    design->{{ ports.flash }} = 1;
{% endif %}
    run(true, 2048);  // until the design has started
    uint32_t head[3];
    while (read_all(head, sizeof head)) {
        std::vector<uint16_t> symbols(head[0]);
        if (head[0] && !read_all(symbols.data(), 2 * symbols.size())) return 1;
        for (const uint16_t symbol : symbols) send(symbol);
        for (uint32_t k = 0; k < head[2] && received.size() < head[1]; ++k) run(true, DIVIDER);
        const uint32_t reply[2] = {clocks, static_cast<uint32_t>(received.size())};
        std::fwrite(reply, 1, sizeof reply, stdout);
        std::fwrite(received.data(), 1, received.size(), stdout);
        std::fflush(stdout);
        received.clear();
    }
    design->final();
    return 0;
}
