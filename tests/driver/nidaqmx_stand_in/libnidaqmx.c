/* The part of libnidaqmx that the package nidaqmx calls for a multichannel acquisition: one USB-6218 named Dev1.

   No time passes here: every look at the number of samples finds STAND_IN_SAMPLES more (default 200). Sample n of input k
   is (k + 1) V + n counts of 305 uV, so that a lost or repeated one shows. STAND_IN_FAIL=FUNCTION:CODE:CALL makes that
   call of that function fail, once; it is read where a task is made. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define API __attribute__((visibility("default"))) int32_t
#define INPUTS 8

static int inputs, limited, started, available;
static long asked, taken;
static double rate;
static char names[256], error[512];
static struct { char function[40]; int code, call; } failing;

static int failed(int code) {
    snprintf(error, sizeof error, "Stand-in text.\n\nStatus Code: %d", code);
    return code;
}

static int due(const char *function) {
    if (strcmp(function, failing.function) || --failing.call) return 0;
    return failed(failing.code);
}

static int text(const char *value, char *out, uint32_t size) {
    if (!size) return (int)strlen(value) + 1;
    snprintf(out, size, "%s", value);
    return 0;
}

API DAQmxCreateTask(const char *name, void **task) {
    static char ordered[80];
    const char *order = getenv("STAND_IN_FAIL");
    if (order && strcmp(order, ordered)) {
        snprintf(ordered, sizeof ordered, "%s", order);
        failing.function[0] = 0;
        sscanf(order, "%39[^:]:%d:%d", failing.function, &failing.code, &failing.call);
    }
    int code = due("CreateTask");
    inputs = started = available = 0, taken = 0, names[0] = 0;
    *task = &inputs;
    return code;
}

API DAQmxCreateAIVoltageChan(void *task, const char *physical, const char *name, int terminals, double low, double high,
                             int units, const char *scale) {
    int number = -1, code = due("CreateAIVoltageChan");
    if (code) return code;
    if (strncmp(physical, "Dev1/", 5)) return failed(-200220);
    if (sscanf(physical, "Dev1/ai%d", &number) != 1 || number >= 32) return failed(-200170);
    if (high > 10.0 || low != -high || terminals != 10106) return failed(-200077);
    if (inputs++) strcat(names, ", ");
    strcat(names, physical);
    return 0;
}

API DAQmxCfgSampClkTiming(void *task, const char *source, double wanted, int edge, int mode, uint64_t samples) {
    int code = due("CfgSampClkTiming");
    if (code) return code;
    if (wanted * inputs > 250e3) return failed(-200332);
    rate = 20e6 / floor(20e6 / wanted);
    limited = mode == 10178, asked = (long)samples;
    return 0;
}

API DAQmxStartTask(void *task) {
    int code = due("StartTask");
    started = !code;
    return code;
}

API DAQmxStopTask(void *task) { return 0; }

API DAQmxClearTask(void *task) { started = 0; return due("ClearTask"); }

API DAQmxReadAnalogF64(void *task, int32_t samples, double timeout, uint32_t fill, double *out, uint32_t size,
                       int32_t *done, uint32_t *unused) {
    int code = due("ReadAnalogF64");
    *done = 0;
    if (code) return code;
    if (samples > available || (uint32_t)(samples * inputs) > size || fill != 0) return failed(-200284);
    for (int input = 0; input < inputs; input++)
        for (int n = 0; n < samples; n++) out[input * samples + n] = input + 1 + (taken + n) * (10.0 / 32768);
    taken += samples, available -= samples, *done = samples;
    return 0;
}

API DAQmxGetReadAttribute(void *task, int32_t attribute, void *value, uint32_t size) {
    const char *each = getenv("STAND_IN_SAMPLES");
    int code = attribute == 0x1223 ? due("GetReadAttribute") : 0, more = each ? atoi(each) : 200;
    if (code) return code;
    if (attribute == 0x1223) {
        if (!started) return failed(-200983);
        if (limited && taken + available + more > asked) more = (int)(asked - taken - available);
        available += more;
        *(uint32_t *)value = (uint32_t)available;
    } else if (attribute == 0x217b) *(uint32_t *)value = (uint32_t)inputs;
    else if (attribute == 0x1215) *(uint32_t *)value = 0;
    else if (attribute == 0x1823) return text(names, value, size);
    else return failed(-200233);
    return 0;
}

API DAQmxGetTimingAttribute(void *task, int32_t attribute, double *value) {
    if (attribute == 0x1344) *value = rate;
    else if (attribute == 0x1848) *value = 1.0 / 14e-6;
    else return failed(-200233);
    return 0;
}

API DAQmxGetDeviceAttribute(const char *device, int32_t attribute, void *value, uint32_t size) {
    if (strcmp(device, "Dev1")) return failed(-200220);
    if (attribute == 0x0631) return text("USB-6218", value, size);
    if (attribute == 0x0632) { *(uint32_t *)value = 0x1A2B3C4; return 0; }
    return failed(-200233);
}

API DAQmxGetTaskAttribute(void *task, int32_t attribute, void *value, uint32_t size) {
    if (attribute == 0x1276) return text("stand-in", value, size);
    if (attribute == 0x1273) return text(names, value, size);
    if (attribute == 0x2181) { *(uint32_t *)value = (uint32_t)inputs; return 0; }
    return failed(-200233);
}

API DAQmxGetChanAttribute(void *task, const char *channel, int32_t attribute, void *value, uint32_t size) {
    if (attribute == 0x187f) *(int32_t *)value = 10100;
    else if (attribute == 0x0695) *(int32_t *)value = 10322;
    else return failed(-200233);
    return 0;
}

API DAQmxGetSystemInfoAttribute(int32_t attribute, void *value, uint32_t size) {
    if (attribute == 0x1272) *(uint32_t *)value = 24;
    else if (attribute == 0x1923) *(uint32_t *)value = 8;
    else if (attribute == 0x2f22) *(uint32_t *)value = 0;
    else if (attribute == 0x193b) return text("Dev1", value, size);
    else return failed(-200233);
    return 0;
}

API DAQmxGetExtendedErrorInfo(char *out, uint32_t size) { return text(error, out, size); }

API DAQmxGetErrorString(int32_t code, char *out, uint32_t size) { return text("Stand-in warning.", out, size); }
