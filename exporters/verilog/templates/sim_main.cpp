// The core, or its netlist, in Verilator: tokens on stdin, words on stdout, little endian.
//
// request: uint16 number of tokens, then the tokens, uint16 each
// reply to each token STEP: uint32 clocks of the timestep, from its first token on;
//   with --probe, of each neuron int64 current, int64 membrane, uint8 spike; the words, uint32 each
//
// --stall SEED lets tokens and the reader of words wait at random.
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include "Vpolicy_core.h"
#include "verilated.h"

static const uint16_t STEP = 0x8000;
static const uint64_t MOST_CLOCKS = 100000000;  // of a timestep: more is a core that hangs

static Vpolicy_core *core;
static uint32_t stall = 0;  // state of the random numbers; 0 lets nothing wait
static uint64_t clocks = 0;
static std::string words, probed;

static bool waits() {
  if (!stall) return false;
  stall ^= stall << 13;
  stall ^= stall >> 17;
  stall ^= stall << 5;
  return stall & 1;
}

static void append(std::string &to, const void *from, size_t bytes) {
  to.append(static_cast<const char *>(from), bytes);
}

// One clock, after which outputs are those of the next; true if a token was taken.
static bool advance(bool valid, uint16_t token) {
  core->s_axis_tvalid = valid;
  core->s_axis_tdata = token;
  core->m_axis_tready = !waits();
  core->eval();
  const bool taken = valid && core->s_axis_tready;
  if (core->m_axis_tvalid && core->m_axis_tready) {
    const uint32_t word = core->m_axis_tdata;
    append(words, &word, sizeof word);
  }
  core->clk = 1;
  core->eval();
  core->clk = 0;
  core->eval();
  ++clocks;
#ifdef POLICY_PROBE
  if (core->probe_valid) {
    const int64_t current = core->probe_current, membrane = core->probe_membrane;
    const uint8_t spike = core->probe_spike;
    append(probed, &current, sizeof current);
    append(probed, &membrane, sizeof membrane);
    append(probed, &spike, sizeof spike);
  }
#endif
  return taken;
}

static void wait_until_ready() {
  const uint64_t from = clocks;
  while (!core->s_axis_tready) {
    advance(false, 0);
    if (clocks - from > MOST_CLOCKS) {
      fprintf(stderr, "the core does not take a token any more\n");
      exit(1);
    }
  }
}

static void pass_token(uint16_t token) {
  wait_until_ready();
  while (waits()) advance(false, token);
  while (!advance(true, token)) {
  }
}

int main(int count, char **arguments) {
  bool probe = false;
  for (int k = 1; k < count; ++k) {
    if (!strcmp(arguments[k], "--probe")) probe = true;
    else if (!strcmp(arguments[k], "--stall") && k + 1 < count) stall = atoi(arguments[++k]) | 1;
    else {
      fprintf(stderr, "usage: %s [--probe] [--stall SEED]\n", arguments[0]);
      return 2;
    }
  }
  core = new Vpolicy_core;
  core->rst = 1;
  advance(false, 0);
  advance(false, 0);
  core->rst = 0;
  wait_until_ready();
  uint16_t tokens;
  clocks = 0;
  while (fread(&tokens, sizeof tokens, 1, stdin) == 1) {
    for (uint16_t k = 0; k < tokens; ++k) {
      uint16_t token;
      if (fread(&token, sizeof token, 1, stdin) != 1) return 1;
      pass_token(token);
      wait_until_ready();
      if (token == STEP) {
        advance(false, 0);  // the probe is a clock behind
        const uint32_t taken = static_cast<uint32_t>(clocks - 1);
        fwrite(&taken, sizeof taken, 1, stdout);
        if (probe) fwrite(probed.data(), 1, probed.size(), stdout);
        fwrite(words.data(), 1, words.size(), stdout);
        fflush(stdout);
      }
      if (token == STEP || token == 0x8001) {
        words.clear();
        probed.clear();
        clocks = 0;
      }
    }
  }
  core->final();
  delete core;
  return 0;
}
