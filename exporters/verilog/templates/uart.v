// UART: 8 data bits, no parity, 1 stop bit, the least significant bit first.
//
// Receiver and transmitter also tell each data bit as it passes, so that a checksum
// can be computed bit by bit beside them.

`default_nettype none

module uart_rx #(
  parameter integer DIVIDER = 12  // clocks of a bit, at least 4
) (
  input  wire       clk,
  input  wire       rst,
  input  wire       rx,         // the pin; it belongs to no clock
  output reg        bit_valid,  // for a clock: a data bit was sampled, data[7]
  output reg        valid,      // for a clock: `data` is a byte
  output reg        error,      // for a clock: a byte without its stop bit; line noise
  output reg  [7:0] data        // shifted in from above
);
  localparam integer TIMER_BITS = $clog2(DIVIDER);
  localparam [TIMER_BITS-1:0] BIT_TIME = DIVIDER[TIMER_BITS-1:0] - 1'b1;
  localparam integer HALF = DIVIDER / 2;
  localparam [TIMER_BITS-1:0] HALF_TIME = HALF[TIMER_BITS-1:0] - 1'b1;
  localparam [3:0] IDLE = 4'd0, STOP = 4'd1, START = 4'd10;

  reg  [2:0] line;                    // [1] is synchronised, [2] the clock before
  reg  [3:0] bits;                    // to come: IDLE, STOP, 2 to 9 data bits, START
  reg  [TIMER_BITS-1:0] timer;        // clocks until the next sample
  wire level = line[1];
  wire falling = line[2] & ~level;

  always @(posedge clk) begin
    line <= {line[1:0], rx};
    bit_valid <= 1'b0;
    valid <= 1'b0;
    error <= 1'b0;
    if (rst) begin
      line <= 3'b111;
      bits <= IDLE;
    end else if (bits == IDLE) begin
      timer <= HALF_TIME;
      if (falling) bits <= START;
    end else if (timer != 0) begin
      timer <= timer - 1'b1;
    end else begin
      timer <= BIT_TIME;
      bits <= bits - 1'b1;
      case (bits)
        START: if (level) bits <= IDLE;  // too short for a start bit
        STOP: begin
          valid <= level;
          error <= ~level;
        end
        default: begin
          data <= {level, data[7:1]};
          bit_valid <= 1'b1;
        end
      endcase
    end
  end
endmodule

module uart_tx #(
  parameter integer DIVIDER = 12  // clocks of a bit
) (
  input  wire       clk,
  input  wire       rst,
  input  wire [7:0] data,
  input  wire       valid,
  output wire       ready,      // takes `data` where it is valid
  output wire       bit_valid,  // for a clock: `bit_value` is the next data bit on the line
  output wire       bit_value,
  output reg        tx          // the pin
);
  localparam integer TIMER_BITS = $clog2(DIVIDER);
  localparam [TIMER_BITS-1:0] BIT_TIME = DIVIDER[TIMER_BITS-1:0] - 1'b1;

  reg [3:0] bits;                     // still to come: 10 with the start bit, 0 is idle
  reg [7:0] shift;                    // data bits that follow; ones behind them: the stop bit
  reg [TIMER_BITS-1:0] timer;         // clocks until the next bit
  wire next = bits != 0 && timer == 0;

  assign ready = bits == 0;
  assign bit_valid = next && bits > 4'd2;
  assign bit_value = shift[0];

  always @(posedge clk) begin
    if (rst) begin
      bits <= 4'd0;
      tx <= 1'b1;
    end else if (ready) begin
      timer <= BIT_TIME;
      shift <= data;
      if (valid) begin
        bits <= 4'd10;
        tx <= 1'b0;
      end
    end else if (next) begin
      timer <= BIT_TIME;
      bits <= bits - 1'b1;
      tx <= shift[0];
      shift <= {1'b1, shift[7:1]};
    end else begin
      timer <= timer - 1'b1;
    end
  end
endmodule

`default_nettype wire
