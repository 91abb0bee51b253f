// Python module `fixed_arm`: implementation for one arm and this CPU only, as a lower bound of the time. Results are
// written to the caller's arrays. To save time, only their type and layout are checked, not their sizes.
#define NPY_NO_DEPRECATED_API NPY_1_7_API_VERSION
#include <Python.h>
#include <numpy/arrayobject.h>

#include "arm.hpp"

namespace {

peer::Constants constants;

double *numbers(PyObject *object) {
    PyArrayObject *array = reinterpret_cast<PyArrayObject *>(object);
    if (!PyArray_Check(object) || PyArray_TYPE(array) != NPY_DOUBLE || !PyArray_IS_C_CONTIGUOUS(array)) {
        PyErr_SetString(PyExc_TypeError, "float64 arrays in C order");
        return nullptr;
    }
    return static_cast<double *>(PyArray_DATA(array));
}

template <Py_ssize_t COUNT> bool arrays(PyObject *const *args, Py_ssize_t given, double *(&out)[COUNT]) {
    if (given != COUNT) {
        PyErr_SetString(PyExc_TypeError, "wrong number of arrays");
        return false;
    }
    for (Py_ssize_t i = 0; i < COUNT; ++i)
        if (!(out[i] = numbers(args[i]))) return false;
    return true;
}

// configure(values): sets the constants from an array of all members of `Constants`, in their order.
PyObject *configure(PyObject *, PyObject *values) {
    const double *from = numbers(values);
    if (!from) return nullptr;
    if (PyArray_SIZE(reinterpret_cast<PyArrayObject *>(values)) * sizeof(double) != sizeof constants) {
        PyErr_SetString(PyExc_ValueError, "wrong number of constants");
        return nullptr;
    }
    std::memcpy(&constants, from, sizeof constants);
    Py_RETURN_NONE;
}

// kinematics(q, pose, jacobian)
PyObject *kinematics(PyObject *, PyObject *const *args, Py_ssize_t given) {
    double *a[3];
    if (!arrays(args, given, a)) return nullptr;
    peer::Motion<double> m;
    peer::kinematics(constants, a[0], m);
    for (int r = 0; r < 3; ++r) {
        for (int c = 0; c < 3; ++c) a[1][4 * r + c] = m.R[r][c];
        a[1][4 * r + 3] = m.p[r];
        a[1][12 + r] = 0.0;
    }
    a[1][15] = 1.0;
    std::memcpy(a[2], m.J, sizeof m.J);
    Py_RETURN_NONE;
}

// step(q, target, goal, limit)
PyObject *step(PyObject *, PyObject *const *args, Py_ssize_t given) {
    double *a[4];
    if (!arrays(args, given, a)) return nullptr;
    peer::step(constants, a[0], a[1], a[2], a[3]);
    Py_RETURN_NONE;
}

// batch(Q, poses, jacobians): eight configurations at a time; N is a multiple of eight.
PyObject *batch(PyObject *, PyObject *const *args, Py_ssize_t given) {
    double *a[3];
    if (!arrays(args, given, a)) return nullptr;
    const npy_intp count = PyArray_DIM(reinterpret_cast<PyArrayObject *>(args[0]), 0);
    if (count % 8) {
        PyErr_SetString(PyExc_ValueError, "N must be a multiple of eight");
        return nullptr;
    }
    for (npy_intp first = 0; first < count; first += 8) {
        peer::Eight q[peer::N] = {};
        peer::Motion<peer::Eight> m;
        const double *from = a[0] + first * peer::N;
        for (int lane = 0; lane < 8; ++lane)
            for (int i = 0; i < peer::N; ++i) q[i][lane] = from[lane * peer::N + i];
        peer::kinematics(constants, q, m);
        for (int lane = 0; lane < 8; ++lane) {
            double *pose = a[1] + (first + lane) * 16, *jacobian = a[2] + (first + lane) * 6 * peer::N;
            for (int r = 0; r < 3; ++r) {
                for (int c = 0; c < 3; ++c) pose[4 * r + c] = m.R[r][c][lane];
                pose[4 * r + 3] = m.p[r][lane];
                pose[12 + r] = 0.0;
            }
            pose[15] = 1.0;
            for (int r = 0; r < 6; ++r)
                for (int i = 0; i < peer::N; ++i) jacobian[r * peer::N + i] = m.J[r][i][lane];
        }
    }
    Py_RETURN_NONE;
}

template <class F> PyCFunction fast(F *function) {
    return reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(function));
}

PyMethodDef methods[] = {{"configure", configure, METH_O, nullptr},
                         {"kinematics", fast(kinematics), METH_FASTCALL, nullptr},
                         {"step", fast(step), METH_FASTCALL, nullptr},
                         {"batch", fast(batch), METH_FASTCALL, nullptr},
                         {nullptr, nullptr, 0, nullptr}};
PyModuleDef definition = {PyModuleDef_HEAD_INIT, "fixed_arm", nullptr, -1, methods, nullptr, nullptr, nullptr, nullptr};

} // namespace

PyMODINIT_FUNC PyInit_fixed_arm() {
    import_array();
    return PyModule_Create(&definition);
}
