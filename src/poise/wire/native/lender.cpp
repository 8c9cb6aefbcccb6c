#include "lender.h"

#include <unistd.h>

#include <utility>

namespace nb = nanobind;

namespace poise {

Lender::Lender(nb::handle data, nb::handle flags, std::size_t slot)
    : data_(data, PyBUF_SIMPLE), flags_(flags, PyBUF_WRITABLE), slot_(slot), owner_(getpid()) {
  if (slot >= flags_.size()) throw nb::value_error("there is no such slot");
}

// The sender writes as soon as it sees this: not before all was read here.
void Lender::give_back() {
  if (owner_ == getpid()) __atomic_store_n(flags_.begin() + slot_, 0, __ATOMIC_RELEASE);
}

PyType_Slot Lent::slots[] = {{Py_bf_getbuffer, reinterpret_cast<void*>(&Lent::view)},
                             {0, nullptr}};

Lent::Lent(nb::object lender, std::size_t size)
    : lender_(std::move(lender)), from_(nb::cast<Lender&>(lender_)), size_(size) {}

int Lent::view(PyObject* self, Py_buffer* view, int flags) {
  const Lent& lent = *nb::inst_ptr<Lent>(self);
  constexpr int is_read_only = 1;
  return PyBuffer_FillInfo(view, self, lent.from_.data(), static_cast<Py_ssize_t>(lent.size_),
                           is_read_only, flags);
}

nb::object lend(nb::object lender, std::size_t size) {
  const nb::object lent =
      nb::cast(new Lent(std::move(lender), size), nb::rv_policy::take_ownership);
  auto* seen = PyMemoryView_FromObject(lent.ptr());
  if (!seen) throw nb::python_error();
  return nb::steal(seen);
}

}  // namespace poise
