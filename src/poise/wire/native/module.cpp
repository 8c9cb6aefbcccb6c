// What Python sees; src/poise/wire/_channel.pyi describes it.
#include <nanobind/nanobind.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <limits>

#include "channel.h"

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

void send(Channel& channel, nb::list list, double deadline, std::uint32_t block,
          std::uint64_t used) {
  Pieces pieces(list);
  if (pieces.size() > std::numeric_limits<std::uint32_t>::max())
    throw nb::value_error("more than 4 GiB in one frame");
  struct {
    std::uint32_t length, block;
    std::uint64_t used;
  } head{static_cast<std::uint32_t>(pieces.size()), block, used};
  auto& all = pieces.behind(&head, block ? 16 : 8);
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

nb::tuple receive(Channel& channel, double deadline, std::size_t largest) {
  Head head;
  run([&] { return channel.receive_head(head, deadline); }, not_come);
  if (head.length > largest) return nb::make_tuple(head.length, head.block, head.used, nb::none());
  return nb::make_tuple(head.length, head.block, head.used, take(channel, head.length, deadline));
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
      if (piece.iov_len) std::memcpy(place, piece.iov_base, piece.iov_len);
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
      .def("send", &send, nb::arg("pieces"), nb::arg("deadline"), nb::arg("block") = 0,
           nb::arg("used") = 0)
      .def("receive", &receive, nb::arg("deadline"), nb::arg("largest"))
      .def("take", &take, nb::arg("size"), nb::arg("deadline"));
  module.def("fill", &fill, nb::arg("target"), nb::arg("start"), nb::arg("pieces"));
}
