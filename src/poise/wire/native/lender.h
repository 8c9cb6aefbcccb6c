// The receiver's side of a block of shared memory: see src/poise/wire/connections/blocks.py.
#pragma once

#include <nanobind/nanobind.h>
#include <sys/types.h>

#include <cstddef>

#include "memory.h"

namespace poise {

// Where arrays lie that the other end sends, and the byte that says whether they are in use.
class Lender {
 public:
  Lender(nanobind::handle data, nanobind::handle flags, std::size_t slot);

  char* data() const { return data_.begin(); }
  std::size_t size() const { return data_.size(); }
  const char* slot() const { return flags_.begin() + slot_; }
  // A process that was forked has copies, and gives nothing back.
  void give_back();

 private:
  Memory data_, flags_;
  std::size_t slot_;
  pid_t owner_;
};

// What was sent on a block; it is given back when nobody looks at this any more.
class Lent {
 public:
  static PyType_Slot slots[];

  Lent(nanobind::object lender, std::size_t size);
  Lent(const Lent&) = delete;
  Lent& operator=(const Lent&) = delete;
  ~Lent() { from_.give_back(); }

 private:
  static int view(PyObject* self, Py_buffer* view, int flags);

  nanobind::object lender_;
  Lender& from_;
  std::size_t size_;
};

// A read-only memoryview of the first `size` bytes; at most the lender's.
nanobind::object lend(nanobind::object lender, std::size_t size);

}  // namespace poise
