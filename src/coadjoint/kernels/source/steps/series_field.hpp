// The rows of a polynomial field as vectors.
#pragma once

#include "steps/series_rows.hpp"

namespace coadjoint {

template <int W>
struct SeriesField {
    static constexpr int V = SeriesRows<W, double>::V;
    int64_t n, blocks, extended;
    bool written_out, factored;
    Sums<V> products, linear, gradient, factors, outputs;
    std::vector<double> offsets;

    template <class C>
    NOINLINE SeriesField(const Field& field, const C& constants, int64_t order)
        : SeriesField(SeriesRows<W, double>(field, constants, order)) {}

    // The number of vectors of products whose factors are series.
    int64_t series_of_products() const { return factored ? products.blocks : products.size(); }

  private:
    NOINLINE explicit SeriesField(const SeriesRows<W, double>& rows)
        : n(rows.n), blocks(rows.blocks), extended(rows.extended), written_out(rows.written_out),
          factored(rows.factored), offsets(rows.offsets) {
        products.add(rows.products), linear.add(rows.linear), gradient.add(rows.gradient);
        factors.add(rows.factors), outputs.add(rows.outputs);
        for (Sums<V>* sums : {&products, &linear, &gradient, &factors, &outputs}) sums->finish();
    }
};

}  // namespace coadjoint
