// {{ origin }}
//
// The policy on {{ board.title }}: core, link and UART, at {{ board.clock_hz }} Hz.

`default_nettype none

module top (
  input  wire clk,
{% if "button" in ports %}
  input  wire {{ ports.button }},  // starts everything anew; {{ "low" if board.button_low else "high" }} where pressed
{% endif %}
{% if "flash" in ports %}
  input  wire {{ ports.flash }},  // low where the programmer talks to the flash memory, which shares `tx`
{% endif %}
  input  wire rx,    // bytes from the host
  output wire tx,    // bytes to the host
{% if "high" in ports %}
  output wire {{ ports.high }},  // held high
{% endif %}
  output wire {{ ports.lamp }}  // changes with every 16th request, so that it blinks
);
  localparam integer DIVIDER = {{ board.divider }};  // clocks of a bit: {{ board.baud }} baud

  // Nothing starts before the block RAM is up, some microseconds after the configuration, and
  // while the button is pressed.
  reg [8:0] startup = 9'd0;
  reg rst = 1'b1;
{% if "button" in ports %}
  reg [1:0] pressed = 2'b00;  // synchronised
{% endif %}
  always @(posedge clk) begin
{% if "button" in ports %}
    pressed <= {pressed[0], {{ "~" if board.button_low else "" }}{{ ports.button }}};
    if (pressed[1]) startup <= 9'd0;
    else if (!startup[8]) startup <= startup + 1'b1;
{% else %}
    if (!startup[8]) startup <= startup + 1'b1;
{% endif %}
    rst <= ~startup[8];
  end

  wire [7:0] rx_data, tx_data;
  wire rx_valid, rx_error, rx_bit_valid;
  wire tx_valid, tx_ready, tx_bit_valid, tx_bit, tx_level;
  wire [15:0] token;
  wire token_valid, token_ready;
  wire [31:0] word;
  wire word_valid, word_ready, word_last;
  wire blink;

  uart_rx #(.DIVIDER(DIVIDER)) receiver (
    .clk(clk), .rst(rst), .rx(rx),
    .bit_valid(rx_bit_valid), .valid(rx_valid), .error(rx_error), .data(rx_data)
  );

  uart_tx #(.DIVIDER(DIVIDER)) transmitter (
    .clk(clk), .rst(rst), .data(tx_data), .valid(tx_valid), .ready(tx_ready),
    .bit_valid(tx_bit_valid), .bit_value(tx_bit), .tx(tx_level)
  );

  link #(
    .ADDRESS_BITS({{ link.address_bits }}), .PAUSE_BITS({{ board.pause_bits }}),
    .BUFFER_IN_SPRAM({{ use.buffer_in_large_ram | int }})
  ) frames (
    .clk(clk), .rst(rst),
    .rx_data(rx_data), .rx_valid(rx_valid), .rx_error(rx_error), .rx_bit_valid(rx_bit_valid),
    .tx_data(tx_data), .tx_valid(tx_valid), .tx_ready(tx_ready),
    .tx_bit_valid(tx_bit_valid), .tx_bit(tx_bit),
    .m_axis_tdata(token), .m_axis_tvalid(token_valid), .m_axis_tready(token_ready),
    .s_axis_tdata(word), .s_axis_tvalid(word_valid), .s_axis_tready(word_ready),
    .s_axis_tlast(word_last), .blink(blink)
  );

  policy_core #(.STATE_IN_SPRAM({{ use.states_in_large_ram | int }})) core (
    .clk(clk), .rst(rst),
    .s_axis_tdata(token), .s_axis_tvalid(token_valid), .s_axis_tready(token_ready),
    .m_axis_tdata(word), .m_axis_tvalid(word_valid), .m_axis_tready(word_ready),
    .m_axis_tlast(word_last)
  );

{% if "flash" in ports %}
  // the pin belongs to the flash memory while that is selected
  reg [1:0] free = 2'b00;  // synchronised
  always @(posedge clk) free <= {free[0], {{ ports.flash }}};
  assign tx = free[1] ? tx_level : 1'bz;
{% else %}
  assign tx = tx_level;
{% endif %}
{% if "high" in ports %}
  assign {{ ports.high }} = 1'b1;
{% endif %}
  assign {{ ports.lamp }} = {{ "~" if board.lamp_low else "" }}blink;
endmodule

`default_nettype wire
