// POISE_FOR_EACH(macro, a, b, ...) is macro(a) macro(b) ...; for up to 256 names.
#pragma once

#define POISE_PARENS ()
#define POISE_EXPAND(...) \
  POISE_EXPAND3(POISE_EXPAND3(POISE_EXPAND3(POISE_EXPAND3(__VA_ARGS__))))
#define POISE_EXPAND3(...) \
  POISE_EXPAND2(POISE_EXPAND2(POISE_EXPAND2(POISE_EXPAND2(__VA_ARGS__))))
#define POISE_EXPAND2(...) \
  POISE_EXPAND1(POISE_EXPAND1(POISE_EXPAND1(POISE_EXPAND1(__VA_ARGS__))))
#define POISE_EXPAND1(...) __VA_ARGS__
#define POISE_FOR_EACH(macro, ...) __VA_OPT__(POISE_EXPAND(POISE_STEP(macro, __VA_ARGS__)))
#define POISE_STEP(macro, first, ...) \
  macro(first) __VA_OPT__(POISE_STEP_AGAIN POISE_PARENS(macro, __VA_ARGS__))
#define POISE_STEP_AGAIN() POISE_STEP
