// Frames over a UART: tokens for the core in, words of the core out.
//
//   request   A5  sequence  n  n tokens of 2 bytes  CRC of 2 bytes
//   reply     5A  sequence  n  n words of 4 bytes   CRC of 2 bytes
//
// Low bytes come first. The CRC is CRC-16/MCRF4XX (polynomial 1021 reflected, from FFFF) of all
// bytes after the first; over a frame with its CRC it is 0.
//
// Nothing reaches the core before the CRC is right; 16 bits of it pass one of 65,536 damaged
// requests. Each good request is answered after its last token, or the last word, is taken; the
// core may still be busy then, and its `tready` holds the next token back. A request with the
// sequence number of the one before it is a repetition: it is not done again, and the reply, which
// is kept, is sent again. Whatever is not a good request is not answered; the host repeats after a
// while. A pause within a request ends it, and so does a byte without a stop bit. While the core
// works and while a reply is sent, the receiver is deaf.
//
// After a reset the states of the core are gone: requests with tokens are not answered until an
// empty one has come, which a host sends where it begins. A host that does not know of the reset
// gets no answer, and says so, where it would get words of states that were forgotten.
//
// A request must not cause more words than the buffer holds, 2**ADDRESS_BITS / 4, nor more than
// 255; nothing here checks it. link.py, and so host.py, never sends such a request.

`default_nettype none

module link #(
  parameter integer ADDRESS_BITS = 8,  // 8 to 10; the buffer holds 2**this numbers of 16 bits:
                                       // tokens below, words above, two numbers each
  parameter integer PAUSE_BITS = 16,   // 2**this clocks of silence end a request
  parameter integer BUFFER_IN_SPRAM = 0  // 1: in single-port RAM of the UltraPlus
) (
  input  wire        clk,
  input  wire        rst,
  // bytes of the receiver
  input  wire [7:0]  rx_data,
  input  wire        rx_valid,
  input  wire        rx_error,
  input  wire        rx_bit_valid,
  // bytes for the transmitter
  output reg  [7:0]  tx_data,
  output wire        tx_valid,
  input  wire        tx_ready,
  input  wire        tx_bit_valid,
  input  wire        tx_bit,
  // tokens for the core
  output wire [15:0] m_axis_tdata,
  output wire        m_axis_tvalid,
  input  wire        m_axis_tready,
  // words of the core
  input  wire [31:0] s_axis_tdata,
  input  wire        s_axis_tvalid,
  output wire        s_axis_tready,
  input  wire        s_axis_tlast,
  output wire        blink             // changes with every 16th request
);
  localparam [7:0] REQUEST = 8'hA5, REPLY = 8'h5A;
  localparam [15:0] END_OF_TIMESTEP = 16'h8000;
  localparam integer INDEX_BITS = ADDRESS_BITS - 1;
  localparam [7:0] TOKENS = INDEX_BITS < 8 ? 8'd128 : 8'd255;  // of a request, at most

  localparam [4:0]
    HUNT           = 5'd0,   // for the first byte of a request
    SEQUENCE       = 5'd1,   // receive the parts of a request ...
    LENGTH         = 5'd2,
    TOKEN_LOW      = 5'd3,
    TOKEN_HIGH     = 5'd4,
    CHECK_LOW      = 5'd5,
    CHECK_HIGH     = 5'd6,
    DECIDE         = 5'd7,   // new, a repetition, or wrong?
    NEXT_TOKEN     = 5'd8,   // wait for the buffer
    OFFER          = 5'd9,   // a token to the core
    WORD_LOW       = 5'd10,  // store the core's words, in halves
    WORD_HIGH      = 5'd11,
    SEND_FIRST     = 5'd16,  // send the parts of a reply ...
    SEND_SEQUENCE  = 5'd17,
    SEND_LENGTH    = 5'd18,
    SEND_LOW       = 5'd19,
    SEND_HIGH      = 5'd20,
    SEND_CHECK     = 5'd21,
    SEND_CHECK_TOO = 5'd22,
    DRAIN          = 5'd23;  // until the last byte is out

  reg [4:0]  state;
  reg [7:0]  sequence_in;             // of the request that comes in
  reg [7:0]  sequence_done;           // of the last one that was done
  reg        greeted;                 // an empty request has come since the reset
  reg [7:0]  length;                  // tokens of the request
  reg [8:0]  index;                   // of a token, or of a half of a word
  reg [8:0]  halves;                  // of words in the buffer
  reg [7:0]  low;                     // of the token that comes in
  reg [15:0] crc;
  reg [PAUSE_BITS-1:0] pause;         // clocks since the last byte of the request

  reg [15:0] buffered;                // what stands at `index`, a clock later
  wire receiving = state != HUNT && state <= CHECK_HIGH;
  wire sending = state[4];
  wire store_token = state == TOKEN_HIGH && rx_valid;
  wire store_word = (state == WORD_LOW && s_axis_tvalid) || state == WORD_HIGH;
  wire [15:0] stored = store_token ? {rx_data, low}
    : state == WORD_HIGH ? s_axis_tdata[31:16] : s_axis_tdata[15:0];
  wire [ADDRESS_BITS-1:0] write_address = store_token ? {1'b0, index[INDEX_BITS-1:0]}
    : {1'b1, halves[INDEX_BITS-1:0]};

  wire store = store_token || store_word;
  wire [ADDRESS_BITS-1:0] read_address = {sending, index[INDEX_BITS-1:0]};

  generate
    if (BUFFER_IN_SPRAM != 0) begin : in_spram
      wire [ADDRESS_BITS-1:0] address = store ? write_address : read_address;
      (* ram_style = "huge" *) reg [15:0] buffer [0:(1 << ADDRESS_BITS) - 1];
      always @(posedge clk) if (store) buffer[address] <= stored; else buffered <= buffer[address];
    end else begin : in_block_ram
      // what is written is never read in the same clock
      (* no_rw_check *) reg [15:0] buffer [0:(1 << ADDRESS_BITS) - 1];
      always @(posedge clk) begin
        if (store) buffer[write_address] <= stored;
        buffered <= buffer[read_address];
      end
    end
  endgenerate

  // the CRC shifts its own bits out: fed with its lowest bit it shifts in zeros
  wire crc_valid = sending ? tx_bit_valid : rx_bit_valid;
  wire crc_flip = crc[0] ^ (sending ? tx_bit : rx_data[7]);
  always @(posedge clk) begin
    if (state == HUNT || state == SEND_SEQUENCE) crc <= 16'hFFFF;
    else if (crc_valid) crc <= {1'b0, crc[15:1]} ^ (crc_flip ? 16'h8408 : 16'h0000);
  end

  always @(posedge clk) begin
    if (!receiving || rx_valid) pause <= {PAUSE_BITS{1'b0}};
    else pause <= pause + 1'b1;
  end

  wire last_token = index[7:0] == length;
  wire last_half = index == halves;
  wire end_of_timestep = buffered == END_OF_TIMESTEP;

  always @(posedge clk) begin
    if (rst) begin
      state <= HUNT;
      sequence_done <= 8'd0;
      greeted <= 1'b0;
      halves <= 9'd0;
    end else if (receiving && (rx_error || &pause)) begin
      state <= HUNT;
    end else begin
      case (state)
        HUNT: if (rx_valid && rx_data == REQUEST) state <= SEQUENCE;
        SEQUENCE: begin
          index <= 9'd0;
          sequence_in <= rx_data;
          if (rx_valid) state <= LENGTH;
        end
        LENGTH: begin
          length <= rx_data;
          if (rx_valid) state <= rx_data > TOKENS ? HUNT : TOKEN_LOW;
        end
        TOKEN_LOW: begin
          low <= rx_data;
          if (last_token) state <= CHECK_LOW;  // no byte comes in this clock
          else if (rx_valid) state <= TOKEN_HIGH;
        end
        TOKEN_HIGH: if (rx_valid) begin
          index <= index + 1'b1;
          state <= TOKEN_LOW;
        end
        CHECK_LOW: if (rx_valid) state <= CHECK_HIGH;
        CHECK_HIGH: if (rx_valid) state <= DECIDE;
        DECIDE: begin
          index <= 9'd0;
          if (crc == 0 && length == 0) greeted <= 1'b1;
          if (crc != 0 || !(greeted || length == 0)) state <= HUNT;
          else if (sequence_in == sequence_done) state <= SEND_FIRST;
          else begin
            sequence_done <= sequence_in;
            halves <= 9'd0;
            state <= NEXT_TOKEN;
          end
        end
        NEXT_TOKEN: begin
          if (last_token) begin
            index <= 9'd0;
            state <= SEND_FIRST;
          end else state <= OFFER;
        end
        OFFER: if (m_axis_tready) begin
          index <= index + 1'b1;
          state <= end_of_timestep ? WORD_LOW : NEXT_TOKEN;
        end
        WORD_LOW: if (s_axis_tvalid) begin
          halves <= halves + 1'b1;
          state <= WORD_HIGH;
        end
        WORD_HIGH: begin
          halves <= halves + 1'b1;
          state <= s_axis_tlast ? NEXT_TOKEN : WORD_LOW;
        end
        SEND_FIRST: if (tx_ready) state <= SEND_SEQUENCE;
        SEND_SEQUENCE: if (tx_ready) state <= SEND_LENGTH;
        SEND_LENGTH: if (tx_ready) state <= SEND_LOW;
        SEND_LOW: begin
          if (last_half) state <= SEND_CHECK;
          else if (tx_ready) state <= SEND_HIGH;
        end
        SEND_HIGH: if (tx_ready) begin
          index <= index + 1'b1;
          state <= SEND_LOW;
        end
        SEND_CHECK: if (tx_ready) state <= SEND_CHECK_TOO;
        SEND_CHECK_TOO: if (tx_ready) state <= DRAIN;
        DRAIN: if (tx_ready) state <= HUNT;
        default: state <= HUNT;
      endcase
    end
  end

  assign m_axis_tdata = buffered;
  assign m_axis_tvalid = state == OFFER;
  assign s_axis_tready = state == WORD_HIGH;
  assign tx_valid = sending && state != DRAIN && !(state == SEND_LOW && last_half);
  assign blink = sequence_done[4];

  always @* begin
    case (state)
      SEND_FIRST: tx_data = REPLY;
      SEND_SEQUENCE: tx_data = sequence_done;
      SEND_LENGTH: tx_data = halves[8:1];
      SEND_LOW: tx_data = buffered[7:0];
      SEND_HIGH: tx_data = buffered[15:8];
      default: tx_data = crc[7:0];
    endcase
  end
endmodule

`default_nettype wire
