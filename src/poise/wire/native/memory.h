// Memory of Python's.
#pragma once

#include <nanobind/nanobind.h>

#include <cstddef>

namespace poise {

// The memory of a bytes-like object, held for as long as this lives.
class Memory {
 public:
  Memory(nanobind::handle object, int wanted) {
    if (PyObject_GetBuffer(object.ptr(), &view_, wanted) != 0) throw nanobind::python_error();
  }
  Memory(Memory&& other) noexcept : view_(other.view_) { other.view_ = {}; }
  Memory& operator=(Memory&&) = delete;
  ~Memory() { PyBuffer_Release(&view_); }

  char* begin() const { return static_cast<char*>(view_.buf); }
  std::size_t size() const { return static_cast<std::size_t>(view_.len); }

 private:
  Py_buffer view_;
};

}  // namespace poise
