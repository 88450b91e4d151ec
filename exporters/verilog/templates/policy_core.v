// The core: a network of CuBa-LIF neurons in integers, one timestep after another.
//
// Tokens come in (s_axis): the number of an input axon that spikes in this timestep; STEP, which
// ends the timestep and computes it; FORGET, which begins a new episode. Others are ignored.
// Words go out (m_axis) while a timestep is computed, of each layer that the host listens to:
// the membrane of each neuron, or the spikes of up to 32 neurons, the first in bit 0.
//
// A spike of an axon has a row of synapses. Each adds its weight to an accumulator of its target,
// of which there is one for each timestep up to the largest delay (a ring of slots), so that a row
// can be worked off at once, whenever its spikes arrive. A timestep then updates all neurons:
//
//   u = fit(part of u + sum of the weights)            part: decay / 2**DECAY_BITS of it, rounded
//   v = fit(part of v + fit(u + voltage bias))               toward zero
//   spike if v > threshold; then v = 0, or v - threshold
//
// Everything that a policy decides is in policy_params.vh and in the contents of the memories.
`default_nettype none

module policy_core #(
    parameter STATE_IN_SPRAM = 0,  // 1: states are in single-port RAM of the UltraPlus
    parameter USE_DSP = 0  // 1: a multiplier of one clock in place of DECAY_BITS additions
) (
    input  wire        clk,
    input  wire        rst,
    input  wire [15:0] s_axis_tdata,
    input  wire        s_axis_tvalid,
    output wire        s_axis_tready,
    output wire [31:0] m_axis_tdata,
    output wire        m_axis_tvalid,
    input  wire        m_axis_tready,
    output wire        m_axis_tlast
`ifdef POLICY_PROBE
    ,
    output reg                probe_valid,
    output reg         [31:0] probe_neuron,
    output reg  signed [63:0] probe_current,
    output reg  signed [63:0] probe_membrane,
    output reg                probe_spike
`endif
);
  `include "policy_params.vh"

  localparam [15:0] STEP = 16'h8000;
  localparam [15:0] FORGET = 16'h8001;

  // ---------------------------------------------------------------------------------------------
  // Registers

  localparam [3:0] CLEAR = 0;  // write 0 to the states, the bias to the accumulators
  localparam [3:0] LISTEN = 1;  // take a token
  localparam [3:0] AXON = 2;  // the row of an input axon is known
  localparam [3:0] FIRST = 3;  // its first synapse is being read
  localparam [3:0] DELIVER = 4;  // a synapse in each clock
  localparam [3:0] FLUSH = 5;  // its last sum is being written
  localparam [3:0] READ = 6;  // a state of a neuron is being read
  localparam [3:0] DECAY = 7;  // a bit of the decay in each clock
  localparam [3:0] ADD = 8;  // what is left of the state, and what arrives
  localparam [3:0] PUSH = 9;  // the current is written; it and the bias go to the membrane
  localparam [3:0] FIRE = 10;  // the membrane is compared with the threshold
  localparam [3:0] SUBTRACT = 11;  // the threshold leaves the membrane
  localparam [3:0] STORE = 12;  // the membrane is written
  localparam [3:0] ALIGN = 13;  // the last spikes of a layer move to the lowest bits of a word
  localparam [3:0] EMIT = 14;  // a word leaves

  reg [3:0] state;
  reg [NEURON_BITS-1:0] neuron;  // the one that is updated or cleared
  reg pass;  // 0: its current, 1: its membrane
  reg [SLOT_BITS-1:0] slot;  // of the accumulators of this timestep
  reg updating;  // a timestep is being computed: rows are those of neurons

  reg signed [VALUE_BITS-1:0] value;  // current, push, membrane [state units]
  reg signed [STATE_BITS-1:0] product;  // the part of a state that is left [state units]
  reg fraction;  // the bits that the product has lost are not all 0
  reg [COUNT_BITS-1:0] count;  // bit of the decay
  reg spiked;  // the neuron spikes in this timestep

  reg [SYNAPSE_ADDRESS_BITS-1:0] synapse_address;  // of the synapse that is read
  reg negate;  // the row is subtracted
  reg [SLOT_BITS+NEURON_BITS-1:0] target;  // slots from now, and neuron: of the last synapse
  reg signed [WEIGHT_BITS-1:0] weight;  // of the last synapse [units of its target's layer]
  reg [SLOT_BITS+NEURON_BITS-1:0] sum_address;  // of the accumulator that it is added to
  reg adding;  // that accumulator has been read

  wire last_neuron = neuron == LAST_NEURON;
  wire take = s_axis_tvalid && state == LISTEN;

  // ---------------------------------------------------------------------------------------------
  // Memories

  // input axon -> its row
  reg [ROW_BITS-1:0] axon_memory[0:AXONS-1];
  reg [ROW_BITS-1:0] axon_row;
  initial $readmemh("axons.hex", axon_memory);
  always @(posedge clk) if (take) axon_row <= axon_memory[s_axis_tdata[AXON_BITS-1:0]];

  // rows of synapses
  reg [SYNAPSE_BITS-1:0] synapse_memory[0:SYNAPSES-1];
  reg [SYNAPSE_BITS-1:0] synapse;
  initial $readmemh("synapses.hex", synapse_memory);
  always @(posedge clk) synapse <= synapse_memory[synapse_address];

  wire synapse_last = synapse[SYNAPSE_BITS-1];
  wire [GAP_BITS-1:0] synapse_gap = synapse[WEIGHT_BITS+:GAP_BITS];

  // parameters of neurons
  reg [NEURON_WORD_BITS-1:0] neuron_memory[0:NEURONS-1];
  reg [NEURON_WORD_BITS-1:0] parameters;
  initial $readmemh("neurons.hex", neuron_memory);
  always @(posedge clk) parameters <= neuron_memory[neuron];

  // sums of the weights that arrive [units of the layer], a ring of slots for each neuron
  // no_rw_check: what is read and written in one clock is not used
  (* no_rw_check *) reg signed [SUM_BITS-1:0] sum_memory[0:SUMS-1];
  reg signed [SUM_BITS-1:0] sum;
  wire sum_write;
  wire signed [SUM_BITS-1:0] sum_written;
  // verilator lint_off WIDTH
  // verilator lint_off UNUSEDSIGNAL
  // where there is one slot, its bit is 0 and left out
  wire [SLOT_BITS+NEURON_BITS-1:0] sum_read_address, sum_write_address;
  always @(posedge clk) begin
    if (sum_write) sum_memory[sum_write_address] <= sum_written;
    sum <= sum_memory[sum_read_address];
  end
  // verilator lint_on UNUSEDSIGNAL
  // verilator lint_on WIDTH

  // currents and membranes [state units]; beside a membrane the timesteps that the neuron rests
  wire state_write;
  wire [NEURON_BITS:0] state_address = {pass, neuron};
  wire [STATE_WORD_BITS-1:0] state_written;
  wire [STATE_WORD_BITS-1:0] state_word;
  policy_ram #(
      .BITS(STATE_WORD_BITS),
      .ADDRESS_BITS(NEURON_BITS + 1),
      .HUGE(STATE_IN_SPRAM)
  ) state_memory (
      .clk(clk),
      .write(state_write),
      .address(state_address),
      .written(state_written),
      .word(state_word)
  );
  wire signed [STATE_BITS-1:0] kept = state_word[STATE_BITS-1:0];

  // ---------------------------------------------------------------------------------------------
  // Parameters of the neuron: its own, or those of its layer

  wire [LAYER_BITS-1:0] layer = parameters[LAYER_BITS-1:0];
  wire [DECAY_FIELD-1:0] current_decay, membrane_decay;
  wire signed [VOLTAGE_BIAS_FIELD-1:0] voltage_bias;
  wire [THRESHOLD_FIELD-1:0] threshold;
  wire signed [SUM_BITS-1:0] bias;
  wire [ROW_BITS-1:0] neuron_row;
  wire spiking, heard, closing;

  policy_field #(DECAY_FIELD, CURRENT_DECAY_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      CURRENT_DECAY_OF) field_current_decay (parameters, layer, current_decay);
  policy_field #(DECAY_FIELD, MEMBRANE_DECAY_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      MEMBRANE_DECAY_OF) field_membrane_decay (parameters, layer, membrane_decay);
  policy_field #(VOLTAGE_BIAS_FIELD, VOLTAGE_BIAS_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      VOLTAGE_BIAS_OF) field_voltage_bias (parameters, layer, voltage_bias);
  policy_field #(THRESHOLD_FIELD, THRESHOLD_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      THRESHOLD_OF) field_threshold (parameters, layer, threshold);
  policy_field #(SUM_BITS, BIAS_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      BIAS_OF) field_bias (parameters, layer, bias);
  policy_field #(ROW_BITS, ROW_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      ROW_OF) field_row (parameters, layer, neuron_row);
  // spikes, and has no membrane for the host
  policy_field #(1, SPIKING_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      SPIKING_OF) field_spiking (parameters, layer, spiking);
  // the host listens to it
  policy_field #(1, HEARD_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      HEARD_OF) field_heard (parameters, layer, heard);
  // a word of spikes ends with it
  policy_field #(1, CLOSING_AT, NEURON_WORD_BITS, LAYERS, LAYER_BITS,
      CLOSING_OF) field_closing (parameters, layer, closing);

  // ---------------------------------------------------------------------------------------------
  // Synapses: sum of the target += or -= weight

  // verilator lint_off WIDTH
  wire signed [SUM_BITS-1:0] wide_weight = weight;  // the sign is extended
  wire [SLOT_BITS+NEURON_BITS-1:0] next_target = target + synapse_gap;
  // verilator lint_on WIDTH
  wire [SLOT_BITS-1:0] next_slot = (slot + next_target[NEURON_BITS+:SLOT_BITS]) & SLOT_MASK;

  assign sum_read_address = state == DELIVER ?
      {next_slot, next_target[NEURON_BITS-1:0]} : {slot, neuron};
  assign sum_write = adding || state == STORE || (state == CLEAR && pass);
  assign sum_write_address = adding ? sum_address : {slot, neuron};
  assign sum_written = !adding ? bias : negate ? sum - wide_weight : sum + wide_weight;

  // ---------------------------------------------------------------------------------------------
  // Decays: product = decay / 2**DECAY_BITS of the state, rounded down; fraction tells the rest, so
  // that the adder can round toward zero

  wire [DECAY_FIELD-1:0] decay = pass ? membrane_decay : current_decay;
  wire keeps_nothing = decay == 0;
  wire keeps_all = DECAY_FIELD > DECAY_BITS && decay[DECAY_FIELD-1];
  wire decayed = USE_DSP != 0 || count == LAST_BIT;

  wire signed [STATE_BITS-1:0] next_product;
  wire next_fraction;
  generate
    if (USE_DSP != 0) begin : dsp
      // verilator lint_off UNUSEDSIGNAL
      wire signed [STATE_BITS+DECAY_FIELD:0] whole = kept * $signed({1'b0, decay});
      // verilator lint_on UNUSEDSIGNAL
      assign next_product = whole[DECAY_BITS+:STATE_BITS];
      assign next_fraction = |whole[DECAY_BITS-1:0];
    end else begin : serial
      // the lowest bit of the decay first: each addition loses the lowest bit of the product
      wire signed [STATE_BITS:0] partial = {product[STATE_BITS-1], product}
          + (decay[count] ? {kept[STATE_BITS-1], kept} : {(STATE_BITS + 1) {1'b0}});
      assign next_product = partial[STATE_BITS:1];
      assign next_fraction = fraction | partial[0];
    end
  endgenerate

  // ---------------------------------------------------------------------------------------------
  // Adder: product + sums, current + voltage bias, product + push, membrane - threshold - 1

  wire signed [VALUE_BITS-1:0] drive;
  policy_drive #(SUM_BITS, DRIVE_BITS, VALUE_BITS, LAYERS, LAYER_BITS, SHIFT_OF,
      ACCUMULATOR_KIND, ACCUMULATOR_BITS, ACCUMULATOR_RANGED, ACCUMULATOR_LOW,
      ACCUMULATOR_HIGH) layer_drive (sum, layer, drive);

  reg signed [ADDER_BITS-1:0] left;
  // verilator lint_off WIDTH
  always @*  // signs are extended
    case (state)
      ADD: left = product;
      PUSH: left = voltage_bias;
      default: left = ~$signed({1'b0, threshold});
    endcase
  wire signed [ADDER_BITS-1:0] right = (state == ADD && !pass) ? drive : value;
  // verilator lint_on WIDTH
  wire carry = state == ADD ? (fraction && kept[STATE_BITS-1]) : state == SUBTRACT;
  wire signed [ADDER_BITS-1:0] total = left + right + {{(ADDER_BITS - 1) {1'b0}}, carry};

  wire signed [VALUE_BITS-1:0] fit_current, fit_push, fit_membrane;
  policy_register #(ADDER_BITS, VALUE_BITS, CURRENT_KIND, CURRENT_BITS,
      CURRENT_RANGED, CURRENT_LOW, CURRENT_HIGH) current_register (total, fit_current);
  policy_register #(ADDER_BITS, VALUE_BITS, PUSH_KIND, PUSH_BITS,
      PUSH_RANGED, PUSH_LOW, PUSH_HIGH) push_register (total, fit_push);
  policy_register #(ADDER_BITS, VALUE_BITS, MEMBRANE_KIND, MEMBRANE_BITS,
      MEMBRANE_RANGED, MEMBRANE_LOW, MEMBRANE_HIGH) membrane_register (total, fit_membrane);

  // ---------------------------------------------------------------------------------------------
  // Spikes, and the timesteps that a neuron rests after one

  wire above = !total[ADDER_BITS-1];  // membrane - threshold - 1 >= 0, in FIRE
  wire resting;
  generate
    if (REST_BITS > 0) begin : rests
      wire [REST_BITS-1:0] rest = state_word[STATE_BITS+:REST_BITS];
      wire [REST_BITS-1:0] next_rest = spiked ? RESTS : resting ? rest - 1'b1 : rest;
      assign resting = |rest;
      assign state_written = {state == STORE ? next_rest : {REST_BITS{1'b0}},
          state == CLEAR ? {STATE_BITS{1'b0}} : value[STATE_BITS-1:0]};
    end else begin : no_rests
      assign resting = 0;
      assign state_written = state == CLEAR ? {STATE_BITS{1'b0}} : value[STATE_BITS-1:0];
    end
  endgenerate
  assign state_write = state == CLEAR || state == PUSH || state == STORE;

  // ---------------------------------------------------------------------------------------------
  // Words to the host

  reg [4:0] place;  // bit of the next spike in a word
  wire [31:0] spikes;  // of the last neurons, the last in the highest bit
  generate
    if (HEARS_SPIKES) begin : words
      reg [31:0] shifted;
      always @(posedge clk)
        if (state == STORE || state == ALIGN) shifted <= {state == STORE && spiked, shifted[31:1]};
      assign spikes = shifted;
    end else begin : no_words
      assign spikes = 0;
    end
  endgenerate

  assign s_axis_tready = state == LISTEN;
  assign m_axis_tvalid = state == EMIT;
  // verilator lint_off UNUSEDSIGNAL
  wire [63:0] membrane_word = {{(64 - VALUE_BITS) {value[VALUE_BITS-1]}}, value};
  // verilator lint_on UNUSEDSIGNAL
  assign m_axis_tdata = HEARS_SPIKES && spiking ? spikes : membrane_word[31:0];
  assign m_axis_tlast = neuron == LAST_HEARD;

  // ---------------------------------------------------------------------------------------------
  // The state machine

  wire emits = heard && (!spiking || closing);
  // after STORE and ALIGN, EMIT and a row: what is left to do for this neuron
  wire done = updating && ((state == STORE && !emits && !spiked)
      || (state == EMIT && m_axis_tready && !spiked) || state == FLUSH);

  always @(posedge clk) begin
    adding <= state == DELIVER;
    case (state)
      CLEAR: begin
        pass <= !pass;
        if (pass) begin
          neuron <= last_neuron ? 0 : neuron + 1'b1;
          if (last_neuron) begin
            slot <= (slot + 1'b1) & SLOT_MASK;
            if (slot == SLOT_MASK) state <= LISTEN;
          end
        end
      end
      LISTEN:
      if (take) begin
        if (s_axis_tdata == FORGET) begin
          slot  <= 0;
          state <= CLEAR;
        end else if (s_axis_tdata == STEP) begin
          updating <= 1;
          state <= READ;
        end else if (s_axis_tdata < AXON_COUNT) state <= AXON;
      end
      AXON: begin
        {negate, synapse_address} <= axon_row;
        state <= FIRST;
      end
      FIRST: begin
        synapse_address <= synapse_address + 1'b1;
        target <= updating ? FIRST_OF_NEURONS : FIRST_OF_INPUT;
        state <= DELIVER;
      end
      DELIVER: begin
        synapse_address <= synapse_address + 1'b1;
        target <= next_target;
        sum_address <= sum_read_address;
        weight <= synapse[WEIGHT_BITS-1:0];
        if (synapse_last) state <= FLUSH;
      end
      FLUSH: state <= LISTEN;
      READ: begin
        count <= 0;
        product <= 0;
        fraction <= 0;
        state <= DECAY;
      end
      DECAY: begin
        count <= count + 1'b1;
        if (keeps_all) product <= kept;
        else if (!keeps_nothing) begin
          product  <= next_product;
          fraction <= next_fraction;
        end
        if (decayed || keeps_nothing || keeps_all) state <= ADD;
      end
      ADD: begin
        value <= pass ? fit_membrane : fit_current;
        spiked <= 0;
        state <= !pass ? PUSH : spiking ? FIRE : STORE;
      end
      PUSH: begin
        value <= fit_push;
        pass  <= 1;
        state <= READ;
      end
      FIRE: begin
        spiked <= above && !resting;
        if (resting || (above && !RESET_SUBTRACTS)) value <= 0;
        state <= (RESET_SUBTRACTS && above && !resting) ? SUBTRACT : STORE;
      end
      SUBTRACT: begin
        value <= total[VALUE_BITS-1:0];
        state <= STORE;
      end
      STORE: begin
        {negate, synapse_address} <= neuron_row;
        if (emits) state <= (spiking && place != 31) ? ALIGN : EMIT;
        else if (spiked) state <= FIRST;
        if (spiking && heard) place <= place + 1'b1;
      end
      ALIGN: begin
        place <= place + 1'b1;
        if (place == 31) state <= EMIT;
      end
      EMIT: begin
        place <= 0;
        if (m_axis_tready && spiked) state <= FIRST;
      end
      default: state <= CLEAR;
    endcase

    if (done) begin
      pass <= 0;
      neuron <= last_neuron ? 0 : neuron + 1'b1;
      state <= last_neuron ? LISTEN : READ;
      if (last_neuron) begin
        updating <= 0;
        slot <= (slot + 1'b1) & SLOT_MASK;
      end
    end

    if (rst) begin
      state <= CLEAR;
      neuron <= 0;
      slot <= 0;
      pass <= 0;
      updating <= 0;
      place <= 0;
    end
  end

`ifdef POLICY_PROBE
  // each neuron, when it has been updated
  reg signed [VALUE_BITS-1:0] new_current;
  always @(posedge clk) begin
    if (state == PUSH) new_current <= value;
    probe_valid <= state == STORE && !rst;
    probe_neuron <= {{(32 - NEURON_BITS) {1'b0}}, neuron};
    probe_current <= {{(64 - VALUE_BITS) {new_current[VALUE_BITS-1]}}, new_current};
    probe_membrane <= membrane_word;
    probe_spike <= spiked;
  end
`endif
endmodule

// verilator lint_off DECLFILENAME
// verilator lint_off UNUSEDSIGNAL

// A field of the parameters: each neuron has its own (AT, its lowest bit), or each layer (AT < 0).
module policy_field #(
    parameter BITS = 1,
    parameter AT = -1,
    parameter WORD_BITS = 1,
    parameter LAYERS = 1,
    parameter LAYER_BITS = 1,
    parameter [BITS*LAYERS-1:0] OF_LAYER = 0
) (
    input  wire [ WORD_BITS-1:0] word,
    input  wire [LAYER_BITS-1:0] layer,
    output wire [      BITS-1:0] field
);
  generate
    if (AT >= 0) begin : of_neuron
      assign field = word[AT+:BITS];
    end else begin : of_layer
      reg [BITS-1:0] chosen;
      integer k;
      always @* begin
        chosen = OF_LAYER[BITS-1:0];
        for (k = 1; k < LAYERS; k = k + 1)
          if (layer == k[LAYER_BITS-1:0]) chosen = OF_LAYER[k*BITS+:BITS];
      end
      assign field = chosen;
    end
  endgenerate
endmodule

// What arrives [state units]: the sum, shifted as the neuron's layer says (SHIFT_OF, 8 bits for
// each), as the accumulator holds it.
module policy_drive #(
    parameter SUM_BITS = 1,
    parameter DRIVE_BITS = 1,
    parameter VALUE_BITS = 1,
    parameter LAYERS = 1,
    parameter LAYER_BITS = 1,
    parameter [8*LAYERS-1:0] SHIFT_OF = 0,
    parameter KIND = 0,
    parameter BITS = 2,
    parameter RANGED = 0,
    parameter signed [63:0] LOW = 0,
    parameter signed [63:0] HIGH = 0
) (
    input  wire signed [  SUM_BITS-1:0] sum,
    input  wire        [LAYER_BITS-1:0] layer,
    output wire signed [VALUE_BITS-1:0] drive
);
  reg signed [DRIVE_BITS-1:0] shifted;
  integer k;
  // verilator lint_off WIDTH
  wire signed [DRIVE_BITS-1:0] wide = sum;  // the sign is extended
  // verilator lint_on WIDTH
  always @* begin
    shifted = wide <<< SHIFT_OF[7:0];
    for (k = 1; k < LAYERS; k = k + 1)
      if (layer == k[LAYER_BITS-1:0]) shifted = wide <<< SHIFT_OF[8*k+:8];
  end
  policy_register #(DRIVE_BITS, VALUE_BITS, KIND, BITS, RANGED, LOW,
      HIGH) accumulator (shifted, drive);
endmodule

// A number as a signed register of BITS holds it. KIND: what happens to one that does not fit:
// 0 cannot be; 1 wraps (two's complement); 2 wraps once, where the two edges are read as
// +2**(BITS-1); 3 ends at the largest magnitude; 4 ends at the edges of two's complement.
// RANGED: then it is clipped to LOW and HIGH.
module policy_register #(
    parameter IN_BITS = 2,
    parameter OUT_BITS = 2,
    parameter KIND = 0,
    parameter BITS = 2,
    parameter RANGED = 0,
    parameter signed [63:0] LOW = 0,
    parameter signed [63:0] HIGH = 0
) (
    input  wire signed [ IN_BITS-1:0] number,
    output wire signed [OUT_BITS-1:0] held
);
  wire signed [IN_BITS-1:0] fitted;
  generate
    if (KIND == 0 || BITS >= IN_BITS) begin : none
      assign fitted = number;
    end else if (KIND == 1) begin : wrap
      assign fitted = {{(IN_BITS - BITS) {number[BITS-1]}}, number[BITS-1:0]};
    end else begin : edges
      wire negative = number[IN_BITS-1];
      wire rest = |number[BITS-2:0];  // bits below the one that has the weight of the sign
      wire fits = negative ? &number[IN_BITS-1:BITS-1] : ~|number[IN_BITS-1:BITS-1];
      if (KIND == 2) begin : wrap_once
        // x - 2**BITS where x > 2**(BITS-1); x + 2**BITS where x <= -2**(BITS-1)
        wire at_edge = number[BITS-1] && ~|number[IN_BITS-1:BITS] && !rest;
        wire over = !negative && !fits && !at_edge;
        wire under = negative && !(fits && rest);
        wire [IN_BITS-BITS-1:0] top = number[IN_BITS-1:BITS];
        wire [IN_BITS-BITS-1:0] high = over ? top - 1'b1 : under ? top + 1'b1 : top;
        assign fitted = {high, number[BITS-1:0]};
      end else begin : clip
        wire over = !negative && !fits;
        wire under = negative && (KIND == 3 ? !(fits && rest) : !fits);
        wire [BITS-2:0] low = over ? {(BITS - 1) {1'b1}} : 
            under ? {{(BITS - 2) {1'b0}}, KIND == 3} : number[BITS-2:0];
        assign fitted = {{(IN_BITS - BITS + 1) {negative}}, low};
      end
    end
    wire signed [IN_BITS-1:0] ranged;
    if (!RANGED) begin : whole
      assign ranged = fitted;
    end else begin : between
      wire signed [IN_BITS-1:0] low = LOW[IN_BITS-1:0];
      wire signed [IN_BITS-1:0] high = HIGH[IN_BITS-1:0];
      assign ranged = fitted < low ? low : fitted > high ? high : fitted;
    end
    if (OUT_BITS > IN_BITS) begin : wider
      assign held = {{(OUT_BITS - IN_BITS) {ranged[IN_BITS-1]}}, ranged};
    end else begin : as_wide
      assign held = ranged[OUT_BITS-1:0];
    end
  endgenerate
endmodule

// Memory with one port. HUGE: single-port RAM of the UltraPlus, which cannot be initialised.
module policy_ram #(
    parameter BITS = 1,
    parameter ADDRESS_BITS = 1,
    parameter HUGE = 0
) (
    input  wire                    clk,
    input  wire                    write,
    input  wire [ADDRESS_BITS-1:0] address,
    input  wire [        BITS-1:0] written,
    output reg  [        BITS-1:0] word
);
  generate
    if (HUGE != 0) begin : huge
      (* ram_style = "huge" *) reg [BITS-1:0] memory[0:(1<<ADDRESS_BITS)-1];
      always @(posedge clk) if (write) memory[address] <= written; else word <= memory[address];
    end else begin : block
      reg [BITS-1:0] memory[0:(1<<ADDRESS_BITS)-1];
      always @(posedge clk) if (write) memory[address] <= written; else word <= memory[address];
    end
  endgenerate
endmodule

// verilator lint_on UNUSEDSIGNAL
// verilator lint_on DECLFILENAME
`default_nettype wire
