// Waiting without Python's lock.
#pragma once

#include <Python.h>
#include <unistd.h>

#ifdef Py_LIMITED_API
// Each Python from 3.4 on exports it, though the stable ABI does not list it.
extern "C" int PyGILState_Check(void);
#endif

namespace poise {

// Take the lock by `take`. While Python finalises the interpreter, it ends each thread that does
// so; that thread stays here, for to unwind frames of C++ that may not throw aborts the process.
template <typename Take>
[[gnu::noinline]] void take_lock(Take&& take) {
  struct End {
    ~End() {
      while (is_near) pause();
    }
    bool is_near = true;
  } end;
  take();
  end.is_near = false;
}

// Without the lock for as long as this lives.
class Unlocked {
 public:
  Unlocked() : state_(PyEval_SaveThread()) {}
  ~Unlocked() {
    take_lock([this] { PyEval_RestoreThread(state_); });
  }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;

 private:
  PyThreadState* state_;
};

// With the lock for as long as this lives, on a thread that may be without. One that lost it for
// good meanwhile, in code of Python's, stays here, too.
class Locked {
 public:
  Locked() {
    take_lock([this] { state_ = PyGILState_Ensure(); });
  }
  ~Locked() {
    while (!PyGILState_Check()) pause();
    PyGILState_Release(state_);
  }
  Locked(const Locked&) = delete;
  Locked& operator=(const Locked&) = delete;

 private:
  PyGILState_STATE state_;
};

}  // namespace poise
