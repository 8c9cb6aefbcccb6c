// What Python sees; src/poise/wire/_channel.pyi describes it.
#include <nanobind/nanobind.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>

#include "channel.h"
#include "copy.h"

namespace nb = nanobind;
using poise::Channel;
using poise::Head;
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
      nb::gil_scoped_release unlocked;
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

// The memory of bytes-like objects, held while it is sent.
class Pieces {
 public:
  explicit Pieces(nb::list pieces) {
    views_.reserve(nb::len(pieces));
    vectors_.reserve(nb::len(pieces) + 1);
    vectors_.emplace_back();
    for (nb::handle piece : pieces) {
      Py_buffer view;
      if (PyObject_GetBuffer(piece.ptr(), &view, PyBUF_SIMPLE) != 0) throw nb::python_error();
      views_.push_back(view);
      if (view.len) vectors_.push_back({view.buf, static_cast<std::size_t>(view.len)});
      size_ += static_cast<std::size_t>(view.len);
    }
  }
  Pieces(const Pieces&) = delete;
  Pieces& operator=(const Pieces&) = delete;
  ~Pieces() {
    for (Py_buffer& view : views_) PyBuffer_Release(&view);
  }

  std::size_t size() const { return size_; }
  std::vector<iovec>& behind(void* head, std::size_t length) {
    vectors_.front() = {head, length};
    return vectors_;
  }

 private:
  std::vector<Py_buffer> views_;
  std::vector<iovec> vectors_;
  std::size_t size_ = 0;
};

[[noreturn]] void raise_wire_error(const nb::object& text) {
  raise("poise.wire.codec", "WireError", text);
}

void refuse_too_large(std::size_t size, std::size_t largest, const char* error = "WireError") {
  if (size > largest)
    raise("poise.wire.codec", error,
          nb::str("a frame of {} B; {} B is the largest").format(size, largest));
}

// What `poise.wire.frame` calls things; never given back.
struct Names {
  Names() {
    const auto module = nb::module_::import_("poise.wire.frame");
    frame = nb::object(module.attr("Frame")).release().ptr();
    version = nb::cast<int>(module.attr("VERSION"));
    for (nb::handle kind : nb::object(module.attr("Kind")))
      kinds.at(nb::cast<std::size_t>(kind)) = nb::borrow(kind).release().ptr();
    no_buffers = PyMemoryView_FromObject(nb::bytes("", 0).ptr());
  }
  PyObject* frame;
  PyObject* encode = PyUnicode_InternFromString("encode");
  PyObject* no_buffers;
  std::array<PyObject*, 256> kinds{};
  int version;
};

const Names& names() {
  static const Names* found = new Names();
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
  const double age = 1e-9 * (static_cast<double>(monotonic_now()) - static_cast<double>(head.sent));
  return nb::borrow(names().frame)(nb::borrow(names().kinds[head.kind]), head.tag, head.number,
                                   head.chain, std::move(body), std::move(buffers), size, age);
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
  const auto view = nb::steal(PyMemoryView_FromObject(data.ptr()));
  if (!view.is_valid()) throw nb::python_error();
  const Py_buffer* bytes = PyMemoryView_GET_BUFFER(view.ptr());
  const auto size = static_cast<std::size_t>(bytes->len);
  const FrameHead head = check_head(static_cast<const char*>(bytes->buf), size);
  const std::size_t end = frame_head + head.length;
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
  const nb::object encoded = nb::steal(
      PyObject_CallMethodOneArg(codec.ptr(), names().encode, value.ptr()));
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

void send(Channel& channel, nb::list list, double deadline, std::size_t largest,
          std::uint32_t block, std::uint64_t used) {
  Pieces pieces(list);
  refuse_too_large(pieces.size(), largest);
  Head head{static_cast<std::uint32_t>(pieces.size()), block, used};
  auto& all = pieces.behind(&head, block ? Head::with_block : Head::plain);
  run([&] { return channel.send(all, deadline); }, not_taken);
}

nb::bytes take(Channel& channel, std::size_t size, double deadline) {
  nb::bytes data = nb::steal<nb::bytes>(
      PyBytes_FromStringAndSize(nullptr, static_cast<Py_ssize_t>(size)));
  if (!data.is_valid()) throw nb::python_error();
  char* target = PyBytes_AS_STRING(data.ptr());
  std::size_t left = size;
  if (left <= channel.num_ahead())
    channel.take(target, left, deadline);
  else
    run([&] { return channel.take(target, left, deadline); }, not_come);
  return data;
}

// The frame behind a head, or what Python is to look at.
nb::object rest_of(Channel& channel, const Head& head, double deadline, std::size_t largest) {
  refuse_too_large(head.length, largest, "Unreadable");
  if (head.block)
    return nb::make_tuple(head.block, head.used, take(channel, head.length, deadline));
  if (head.length <= std::min(small, channel.num_ahead())) {
    const char* data = channel.skip(head.length);
    // else there are arrays, whose memory is to be kept
    if (head.length == frame_head + check_head(data, head.length).length)
      return parse_small(data, head.length, nb::borrow(names().no_buffers));
    return parse(nb::bytes(data, head.length), nb::none());
  }
  return parse(take(channel, head.length, deadline), nb::none());
}

nb::object receive(Channel& channel, double deadline, std::size_t largest) {
  Head head;
  run([&] { return channel.receive_head(head, deadline); }, not_come);
  return rest_of(channel, head, deadline, largest);
}

// Both in one step, for one thread; None when the other end has not got the call.
nb::object ask(Channel& channel, nb::list list, double deadline, std::size_t largest) {
  Pieces pieces(list);
  refuse_too_large(pieces.size(), largest);
  Head head{static_cast<std::uint32_t>(pieces.size()), 0, 0};
  auto& all = pieces.behind(&head, Head::plain);
  bool is_sent = false, is_gone = false;
  run(
      [&] {
        if (!is_sent) {
          const Outcome outcome = channel.send(all, deadline);
          is_gone = outcome == Outcome::gone;
          if (outcome != Outcome::done) return is_gone ? Outcome::done : outcome;
          is_sent = true;
        }
        return channel.receive_head(head, deadline);
      },
      "no answer came in time");
  if (is_gone) return nb::none();
  return rest_of(channel, head, deadline, largest);
}

// Copy pieces into memory, end to end, without Python's lock.
void fill(nb::handle target, std::size_t start, nb::list list) {
  Pieces pieces(list);
  Py_buffer view;
  if (PyObject_GetBuffer(target.ptr(), &view, PyBUF_WRITABLE) != 0) throw nb::python_error();
  const auto size = static_cast<std::size_t>(view.len);
  if (start <= size && pieces.size() <= size - start) {
    nb::gil_scoped_release unlocked;
    auto* place = static_cast<char*>(view.buf) + start;
    for (const iovec& piece : pieces.behind(nullptr, 0)) {
      if (piece.iov_len) poise::copy_shared(place, piece.iov_base, piece.iov_len);
      place += piece.iov_len;
    }
  } else {
    PyBuffer_Release(&view);
    throw nb::value_error("the pieces are larger than the memory");
  }
  PyBuffer_Release(&view);
}

}  // namespace

NB_MODULE(_channel, module) {
  nb::set_leak_warnings(false);  // containers end without finalising the interpreter

  nb::class_<Channel>(module, "Channel")
      .def(nb::init<int>(), nb::arg("file"))
      .def("send", &send, nb::arg("pieces"), nb::arg("deadline"), nb::arg("largest"),
           nb::arg("block") = 0, nb::arg("used") = 0)
      .def("receive", &receive, nb::arg("deadline"), nb::arg("largest"))
      .def("ask", &ask, nb::arg("pieces"), nb::arg("deadline"), nb::arg("largest"))
      .def("take", &take, nb::arg("size"), nb::arg("deadline"));
  module.def("parse", &parse, nb::arg("data"), nb::arg("buffers") = nb::none());
  module.def("segments", &segments, nb::arg("codec"), nb::arg("value").none(), nb::arg("kind"),
             nb::arg("tag") = 0, nb::arg("number") = 0, nb::arg("chain") = 0);
  module.def("fill", &fill, nb::arg("target"), nb::arg("start"), nb::arg("pieces"));
}
