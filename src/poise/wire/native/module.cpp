// What Python sees; `make stubs` writes src/poise/wire/_channel.pyi from it.
#include <nanobind/nanobind.h>
#include <poll.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>

#include "channel.h"
#include "filling.h"
#include "lender.h"
#include "memory.h"
#include <poise/unlocked.hpp>

namespace nb = nanobind;
using poise::Channel;
using poise::Head;
using poise::Lender;
using poise::Lent;
using poise::Memory;
using poise::Outcome;

namespace {

[[noreturn]] void raise(const char* module, const char* name, const nb::object& text) {
  PyErr_SetObject(nb::module_::import_(module).attr(name).ptr(), text.ptr());
  throw nb::python_error();
}

// Take a step without Python's lock, again after each signal, until it is done.
template <class Step>
void run(Step step, const char* late) {
  while (true) {
    Outcome outcome;
    int error;
    {
      const poise::Unlocked unlocked;
      outcome = step();
      error = errno;
    }
    if (outcome == Outcome::done) return;
    if (outcome == Outcome::late) raise("poise.errors", "Timeout", nb::str(late));
    if (outcome == Outcome::gone) {
      const char* why = error ? std::strerror(error) : "it closed the connection";
      raise("poise.errors", "Unavailable", nb::str("the other end is gone: {}").format(why));
    }
    if (PyErr_CheckSignals() != 0) throw nb::python_error();
  }
}

constexpr const char* not_taken = "the other end takes no more bytes";
constexpr const char* not_come = "nothing came from the other end in time";

[[noreturn]] void raise_wire_error(const nb::object& text) {
  raise("poise.wire.codec", "WireError", text);
}

void refuse_too_large(std::size_t size, std::size_t largest, const char* error = "WireError") {
  if (size > largest)
    raise("poise.wire.codec", error,
          nb::str("a frame of {} B; {} B is the largest").format(size, largest));
}

// `block` in a head: the number of a block, its slot, and whether it is new here.
constexpr std::uint32_t number_of(std::uint32_t block) { return block & 0xff; }
constexpr std::size_t slot_of(std::uint32_t block) { return block >> 8 & 0xffff; }
constexpr bool is_new(std::uint32_t block) { return block >> 31; }

// The pieces of a frame; with a block, its arrays are copied there or are there already.
class Pieces {
 public:
  Pieces(nb::list pieces, std::size_t largest, std::uint32_t block, std::uint64_t used,
         nb::handle target, int file)
      : head_{0, block, target.is_none() ? used : 0}, file_(file) {
    const std::size_t num_inline = target.is_none() ? nb::len(pieces) : num_inline_with_block;
    const std::size_t padding = num_inline;  // between body and arrays; not in a block
    held_.reserve(nb::len(pieces) + 1);
    vectors_.reserve(nb::len(pieces) + 1);
    vectors_.push_back({&head_, block ? Head::with_block : Head::plain});
    std::vector<iovec> arrays;
    std::size_t length = 0;
    for (nb::handle piece : pieces) {
      const bool is_inline = held_.size() < num_inline;
      const Memory& memory = held_.emplace_back(piece, PyBUF_SIMPLE);
      if (!memory.size() || held_.size() == padding + 1) continue;
      (is_inline ? vectors_ : arrays).push_back({memory.begin(), memory.size()});
      (is_inline ? length : head_.used) += memory.size();
    }
    refuse_too_large(length, largest);
    head_.length = static_cast<std::uint32_t>(length);
    if (target.is_none()) return;
    const Memory& room = held_.emplace_back(target, PyBUF_WRITABLE);
    if (poise::data_offset() + head_.used > room.size())
      throw nb::value_error("the arrays are larger than the block");
    filling_ = poise::Filling(room.begin(), slot_of(block), std::move(arrays));
  }
  Pieces(const Pieces&) = delete;
  Pieces& operator=(const Pieces&) = delete;

  // Copy the arrays to the block, and send the head and the body.
  Outcome send(Channel& channel, double deadline) {
    filling_.begin();
    const Outcome outcome = channel.send(vectors_, deadline, file_);
    if (outcome == Outcome::done) filling_.finish();
    return outcome;
  }

 private:
  // A frame's head and body; padding and arrays follow.
  static constexpr std::size_t num_inline_with_block = 2;

  Head head_;
  std::vector<Memory> held_;
  std::vector<iovec> vectors_;
  poise::Filling filling_;
  int file_;
};

// What `poise.wire.frame` calls things; never given back.
struct Names {
  Names() {
    const auto module = nb::module_::import_("poise.wire.frame");
    frame = nb::object(module.attr("Frame")).release().ptr();
    version = nb::cast<int>(module.attr("VERSION"));
    for (nb::handle kind : nb::object(module.attr("FrameKind")))
      kinds.at(nb::cast<std::size_t>(kind)) = nb::borrow(kind).release().ptr();
    no_buffers = PyMemoryView_FromObject(nb::bytes("", 0).ptr());
  }
  PyObject* frame;
  PyObject* encode = PyUnicode_InternFromString("encode");
  PyObject* no_buffers;
  std::array<PyObject*, 256> kinds{};
  int version;
};

// Making them may give the GIL up. Threads that come meanwhile make some, too: one that waited for
// another would keep the GIL.
const Names& names() {
  static const Names* found = nullptr;
  if (!found) found = new Names();
  return *found;
}

constexpr std::size_t frame_head = 32;
constexpr std::size_t alignment = 16;
// A body of fewer bytes is copied more quickly than looked at.
constexpr std::size_t small = 1 << 12;

struct FrameHead {
  std::uint8_t version, kind;
  std::uint16_t tag;
  std::uint32_t length;
  std::uint64_t number, chain, sent;
};
static_assert(sizeof(FrameHead) == frame_head);

FrameHead check_head(const char* data, std::size_t size) {
  FrameHead head;
  if (size < frame_head) raise_wire_error(nb::str("a frame of {} B is cut short").format(size));
  std::memcpy(&head, data, sizeof head);
  if (head.version != names().version)
    raise_wire_error(nb::str("protocol version {}, but this is version {}")
                         .format(static_cast<int>(head.version), names().version));
  const std::size_t end = frame_head + head.length;
  if (end > size)
    raise_wire_error(nb::str("a frame of {} B is cut short: {} B announced").format(size, end));
  if (!names().kinds[head.kind])
    raise_wire_error(nb::str("unknown kind of frame: {}").format(static_cast<int>(head.kind)));
  return head;
}

std::int64_t monotonic_now() {  // [ns]
  timespec moment{};
  clock_gettime(CLOCK_MONOTONIC, &moment);
  return moment.tv_sec * std::int64_t{1'000'000'000} + moment.tv_nsec;
}

nb::object make_frame(const FrameHead& head, nb::object body, nb::object buffers) {
  const std::size_t size = frame_head + head.length + nb::len(buffers);
  // clocks of two computers may differ by anything: no signed number overflows
  const auto now = static_cast<double>(monotonic_now());
  const double age = 1e-9 * (now - static_cast<double>(head.sent));
  return nb::borrow(names().frame)(nb::borrow(names().kinds[head.kind]), head.tag, head.number,
                                   head.chain, std::move(body), std::move(buffers), size, age,
                                   1e-9 * now);
}

// A frame whose bytes are no longer needed afterwards.
nb::object parse_small(const char* data, std::size_t size, const nb::object& buffers) {
  const FrameHead head = check_head(data, size);
  return make_frame(head, nb::bytes(data + frame_head, head.length), buffers);
}

nb::object part(const nb::object& view, std::size_t start, std::size_t end) {
  auto* found = PySequence_GetSlice(view.ptr(), static_cast<Py_ssize_t>(start),
                                    static_cast<Py_ssize_t>(end));
  if (!found) throw nb::python_error();
  return nb::steal(found).attr("toreadonly")();
}

nb::object parse(nb::object data, nb::object buffers) {
  const Memory bytes(data, PyBUF_SIMPLE);
  const std::size_t size = bytes.size();
  const FrameHead head = check_head(bytes.begin(), size);
  const std::size_t end = frame_head + head.length;
  if (end == size && size <= small && buffers.is_none())
    return parse_small(bytes.begin(), size, nb::borrow(names().no_buffers));
  const auto view = nb::steal(PyMemoryView_FromObject(data.ptr()));
  if (!view.is_valid()) throw nb::python_error();
  if (buffers.is_none()) {
    const std::size_t start = (end + alignment - 1) / alignment * alignment;
    buffers = part(view, std::min(size, start), size);
  }
  return make_frame(head, part(view, frame_head, end), buffers);
}

nb::bytes zeros(std::size_t length) {
  static constexpr char all[alignment] = {};
  return nb::bytes(all, (alignment - length % alignment) % alignment);
}

nb::list segments(nb::handle codec, nb::handle value, int kind, std::uint16_t tag,
                  std::uint64_t number, std::uint64_t chain) {
  PyObject* const arguments[] = {codec.ptr(), value.ptr()};
  const nb::object encoded =
      nb::steal(PyObject_VectorcallMethod(names().encode, arguments, 2, nullptr));
  if (!encoded.is_valid()) throw nb::python_error();
  const nb::object body = encoded[0], buffers = encoded[1];
  const std::size_t length = nb::len(body);
  if (length > UINT32_MAX) raise_wire_error(nb::str("a body of {} B is too large").format(length));
  const FrameHead head{static_cast<std::uint8_t>(names().version),
                       static_cast<std::uint8_t>(kind),
                       tag,
                       static_cast<std::uint32_t>(length),
                       number,
                       chain,
                       static_cast<std::uint64_t>(monotonic_now())};
  nb::list pieces;
  pieces.append(nb::bytes(reinterpret_cast<const char*>(&head), sizeof head));
  pieces.append(body);
  if (nb::len(buffers) == 0) return pieces;
  pieces.append(zeros(frame_head + length));
  for (nb::handle buffer : buffers) {
    pieces.append(buffer);
    pieces.append(zeros(nb::len(buffer)));
  }
  return pieces;
}

std::uintptr_t address(nb::handle memory) {
  return reinterpret_cast<std::uintptr_t>(Memory(memory, PyBUF_SIMPLE).begin());
}

void wait(Channel& channel, short event, double deadline) {
  run([&] { return channel.wait(event, deadline); }, event == POLLOUT ? not_taken : not_come);
}

void send(Channel& channel, nb::list list, double deadline, std::size_t largest,
          std::uint32_t block, std::uint64_t used, nb::handle target, int file) {
  Pieces pieces(list, largest, block, used, target, file);
  run([&] { return pieces.send(channel, deadline); }, not_taken);
}

nb::bytes take(Channel& channel, std::size_t size, double deadline) {
  nb::bytes data = nb::steal<nb::bytes>(
      PyBytes_FromStringAndSize(nullptr, static_cast<Py_ssize_t>(size)));
  if (!data.is_valid()) throw nb::python_error();
  char* target = PyBytes_AsString(data.ptr());
  std::size_t left = size;
  if (left <= channel.num_ahead())
    channel.take(target, left, deadline);
  else
    run([&] { return channel.take(target, left, deadline); }, not_come);
  return data;
}

// The arrays on a block, once the other end of the channel has filled it.
nb::object lend(Channel& channel, nb::object lender, std::uint64_t used, double deadline) {
  const Lender& from = nb::cast<const Lender&>(lender);
  if (used > from.size())
    raise_wire_error(nb::str("{} B announced in a block of {} B").format(used, from.size()));
  if (poise::is_filling(from.slot()))
    run([&] { return poise::wait_until_filled(from.slot(), channel, deadline); }, not_come);
  return poise::lend(std::move(lender), used);
}

// The frame behind a head, or what Python is to look at: it has a block that is new here.
nb::object rest_of(Channel& channel, const Head& head, double deadline, std::size_t largest,
                   const nb::dict& lenders) {
  refuse_too_large(head.length, largest, "Unreadable");
  if (head.block) {
    const nb::bytes data = take(channel, head.length, deadline);
    const nb::object number = nb::cast(number_of(head.block));
    if (is_new(head.block) || !lenders.contains(number))
      return nb::make_tuple(head.block, head.used, data);
    const nb::object lender = lenders[number];
    const nb::object arrays = lend(channel, lender, head.used, deadline);
    return parse(data, arrays);
  }
  if (head.length <= std::min(small, channel.num_ahead())) {
    const char* data = channel.skip(head.length);
    // else there are arrays, whose memory is to be kept
    if (head.length == frame_head + check_head(data, head.length).length)
      return parse_small(data, head.length, nb::borrow(names().no_buffers));
    return parse(nb::bytes(data, head.length), nb::none());
  }
  return parse(take(channel, head.length, deadline), nb::none());
}

nb::object receive(Channel& channel, double deadline, std::size_t largest, nb::dict lenders) {
  Head head;
  run([&] { return channel.receive_head(head, deadline); }, not_come);
  return rest_of(channel, head, deadline, largest, lenders);
}

// Both in one step, for one thread; None when the other end has not got the call.
nb::object ask(Channel& channel, nb::list list, double deadline, std::size_t largest,
               nb::dict lenders, std::uint32_t block, std::uint64_t used, nb::handle target,
               int file) {
  Pieces pieces(list, largest, block, used, target, file);
  Head head;
  bool is_sent = false, is_gone = false;
  run(
      [&] {
        if (!is_sent) {
          const Outcome outcome = pieces.send(channel, deadline);
          is_gone = outcome == Outcome::gone;
          if (outcome != Outcome::done) return is_gone ? Outcome::done : outcome;
          is_sent = true;
        }
        return channel.receive_head(head, deadline);
      },
      "no answer came in time");
  if (is_gone) return nb::none();
  return rest_of(channel, head, deadline, largest, lenders);
}

}  // namespace

#define BYTES "poise.wire.codec.Bytes"
#define PIECES "list[" BYTES "]"
#define BLOCK "block: int = 0, used: int = 0, target: memoryview | None = None, file: int = -1"
#define FRAME "poise.wire.frame.Frame | tuple[int, int, bytes]"

NB_MODULE(_channel, module) {
  nb::set_leak_warnings(false);  // containers end without finalising the interpreter

  nb::class_<Channel>(module, "Channel", "Frames over a connected stream socket (channel.h).")
      .def(nb::init<int, double, bool>(), nb::arg("file"), nb::arg("lost_after"),
           nb::arg("reads_ahead") = true)
      .def("is_lost", &Channel::is_lost)
      .def("wait", &wait, nb::arg("event"), nb::arg("deadline"))
      .def("send", &send, nb::arg("pieces"), nb::arg("deadline"), nb::arg("largest"),
           nb::arg("block") = 0, nb::arg("used") = 0, nb::arg("target") = nb::none(),
           nb::arg("file") = poise::no_file,
           nb::sig("def send(self, pieces: " PIECES ", deadline: float, largest: int, " BLOCK
                   ") -> None"))
      .def("receive", &receive, nb::arg("deadline"), nb::arg("largest"), nb::arg("lenders"),
           nb::sig("def receive(self, deadline: float, largest: int, lenders: dict[int, Lender])"
                   " -> " FRAME))
      .def("ask", &ask, nb::arg("pieces"), nb::arg("deadline"), nb::arg("largest"),
           nb::arg("lenders"), nb::arg("block") = 0, nb::arg("used") = 0,
           nb::arg("target") = nb::none(), nb::arg("file") = poise::no_file,
           nb::sig("def ask(self, pieces: " PIECES ", deadline: float, largest: int, "
                   "lenders: dict[int, Lender], " BLOCK ") -> " FRAME " | None"))
      .def("take_file", &Channel::take_file)
      .def("lend", &lend, nb::arg("lender"), nb::arg("used"), nb::arg("deadline"),
           nb::sig("def lend(self, lender: Lender, used: int, deadline: float) -> memoryview"));
  nb::class_<Lender>(module, "Lender", "The receiver's side of a block (lender.h).")
      .def(nb::init<nb::handle, nb::handle, std::size_t>(), nb::arg("data"), nb::arg("flags"),
           nb::arg("slot"),
           nb::sig("def __init__(self, data: mmap.mmap, flags: mmap.mmap, slot: int) -> None"));
  nb::class_<Lent>(module, "Lent", nb::type_slots(Lent::slots),
                   "What was sent on a block, until nobody looks at it.");
  module.def("parse", &parse, nb::arg("data"), nb::arg("buffers") = nb::none(),
             nb::sig("def parse(data: " BYTES ", buffers: memoryview | None = None)"
                     " -> poise.wire.frame.Frame"));
  module.def("segments", &segments, nb::arg("codec"), nb::arg("value").none(), nb::arg("kind"),
             nb::arg("tag") = 0, nb::arg("number") = 0, nb::arg("chain") = 0,
             nb::sig("def segments(codec: poise.wire.codec.Codec[typing.Any], value: object, "
                     "kind: int, tag: int = 0, number: int = 0, chain: int = 0) -> " PIECES));
  module.def("address", &address, nb::arg("memory"),
             nb::sig("def address(memory: " BYTES ") -> int"));
}
