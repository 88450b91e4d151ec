// Self-checking bench, for Verilator and Icarus: the tokens of recorded timesteps go in, and all
// that comes out must be as the emulator has it: every word, and with POLICY_PROBE every current,
// membrane and spike. +stall=SEED lets tokens and the reader of words wait at random; +restart=CLOCK
// resets the core once more in that clock, and begins anew.
//
// -DNETLIST: the core has been synthesised.
//
//   with Icarus:    iverilog -DPOLICY_PROBE -o bench bench.v policy_core.v && vvp bench
//   with Verilator: verilator --binary -DPOLICY_PROBE bench.v policy_core.v && obj_dir/Vbench
`timescale 1ns / 1ps
`default_nettype none

module bench #(
    parameter STATE_IN_SPRAM = 0,  // of the core
    parameter USE_DSP = 0
);
  `include "vectors.vh"  // numbers of TOKENS, WORDS and UPDATES

  reg [15:0] tokens[0:TOKENS-1];
  reg [32:0] words[0:WORDS-1];  // {last, word}
  initial $readmemh("tokens.hex", tokens);
  initial $readmemh("words.hex", words);

  reg clk = 0;
  initial forever #5 clk = !clk;

  reg rst = 1, offered = 0, listens = 0;
  integer clocks = 0, token = 0, word = 0, wrong = 0;
  reg [31:0] noise = 0;  // random bits; 0 lets nothing wait
  integer restart = -1;
  initial begin
    if (!$value$plusargs("stall=%d", noise)) noise = 0;
    if (!$value$plusargs("restart=%d", restart)) restart = -1;
  end

  wire s_axis_tready, m_axis_tvalid, m_axis_tlast;
  wire [31:0] m_axis_tdata;
  wire s_axis_tvalid = offered && token < TOKENS;
`ifdef POLICY_PROBE
  reg [128:0] updates[0:UPDATES-1];  // {current, membrane, spike}
  initial $readmemh("updates.hex", updates);
  wire probe_valid, probe_spike;
  wire [31:0] probe_neuron;
  wire signed [63:0] probe_current, probe_membrane;
  integer update = 0;
  wire all_seen = word == WORDS && update == UPDATES;
`else
  wire all_seen = word == WORDS;
`endif

`ifdef NETLIST
  policy_core core (  // its parameters are decided
`else
  policy_core #(
      .STATE_IN_SPRAM(STATE_IN_SPRAM),
      .USE_DSP(USE_DSP)
  ) core (
`endif
      .clk(clk),
      .rst(rst),
      .s_axis_tdata(tokens[token]),
      .s_axis_tvalid(s_axis_tvalid),
      .s_axis_tready(s_axis_tready),
      .m_axis_tdata(m_axis_tdata),
      .m_axis_tvalid(m_axis_tvalid),
      .m_axis_tready(listens),
      .m_axis_tlast(m_axis_tlast)
`ifdef POLICY_PROBE
      ,
      .probe_valid(probe_valid),
      .probe_neuron(probe_neuron),
      .probe_current(probe_current),
      .probe_membrane(probe_membrane),
      .probe_spike(probe_spike)
`endif
  );

  always @(posedge clk) begin
    clocks <= clocks + 1;
    rst <= clocks < 3 || (clocks >= restart && clocks < restart + 3);
    // what has been offered stays until it is taken
    offered <= (offered && !s_axis_tready) || noise == 0 || noise[7];
    listens <= noise == 0 || noise[23];
    noise <= {noise[30:0], noise[31] ^ noise[21] ^ noise[1] ^ noise[0]};
    if (s_axis_tvalid && s_axis_tready && !rst) token <= token + 1;
    if (m_axis_tvalid && listens && !rst) begin
      if (word >= WORDS || words[word] !== {m_axis_tlast, m_axis_tdata}) begin
        if (wrong < 10) $display("word %0d is %h", word, {m_axis_tlast, m_axis_tdata});
        wrong <= wrong + 1;
      end
      word <= word + 1;
    end
`ifdef POLICY_PROBE
    if (probe_valid && !rst) begin
      if (update >= UPDATES
          || updates[update] !== {probe_current, probe_membrane, probe_spike}) begin
        if (wrong < 10)
          $display("update %0d, neuron %0d: current %0d, membrane %0d, spike %0d", update,
                   probe_neuron, probe_current, probe_membrane, probe_spike);
        wrong <= wrong + 1;
      end
      update <= update + 1;
    end
`endif
    if (rst) begin
      token <= 0;
      word <= 0;
`ifdef POLICY_PROBE
      update <= 0;
`endif
    end
    // the core has been ready for some clocks after the last token
    if (token == TOKENS && s_axis_tready && !rst && all_seen) begin
      if (wrong == 0) $display("PASS: %0d tokens, %0d words, %0d clocks", token, word, clocks);
      else $display("FAIL: %0d numbers differ", wrong);
      $finish;
    end
    if (clocks > MOST_CLOCKS || wrong > 10) begin
      $display("FAIL: %0d numbers differ; %0d of %0d words have come", wrong, word, WORDS);
      $finish;
    end
  end
endmodule

`default_nettype wire
